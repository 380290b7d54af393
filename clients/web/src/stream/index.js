export { Client } from './client.js';
export { RequestQueue } from './queue.js';
export { ByteCache } from './cache.js';
export { MotionMeter, motionFactor } from './motion.js';
export { LevelSelector, levelOnScreen, refinementSteps } from './selector.js';
export { LevelStream, keyOf } from './stream.js';
export { FrameBudget, scheduleLevels } from './scheduler.js';
export { upload } from './upload.js';
export { followJob } from './jobs.js';
