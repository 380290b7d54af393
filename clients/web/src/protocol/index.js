export { Urls } from './urls.js';
export { parseManifest, parseModelList, familyLevels } from './manifest.js';
export { parseLevelHeaders } from './headers.js';
export { errorPixels, errorUnits, selectLevel, unitsPerPixel, viewDistance } from './screen.js';
export { ProtocolError, problemFromResponse, sentence } from './problem.js';
export { EventStreamParser } from './events.js';
export { modelIdFromFileName, modelIdValid, uniqueModelId } from './ids.js';
