/** Worker: vertex normals off the main thread. In: {id, positions, index}; out: {id, normals, corners, sources} or {id, error}. */
import { computeCreasedNormals } from './normals.js';

self.onmessage = ({ data: { id, positions, index } }) => {
  try {
    const { normals, corners, sources } = computeCreasedNormals(positions, index);
    self.postMessage({ id, normals, corners, sources }, [normals.buffer, corners.buffer, sources.buffer]);
  } catch (error) {
    self.postMessage({ id, error: String(error?.message ?? error) });
  }
};
