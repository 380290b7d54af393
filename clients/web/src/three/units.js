/**
 * A step in units (codec/FORMAT.md, 6.3): patches of the coarser level are asked for by what one looks at, decoded in the worker as they come, and
 * drawn as fragments beside the coarser level's own triangles, without cracks. When the last one is there the result is the finer level.
 */

import { Group, Mesh } from 'three';
import { ProtocolError } from '../protocol/problem.js';
import { batches, lookOrder } from '../stream/units.js';
import { levelFromArrays } from './deltas.js';
import { MorphObject, describeLevel, morphable } from './morph.js';

/** Drawing takes longer than decoding: the picture changes at most so often on the way. */
const DRAWINGS = 6;

export class UnitsLoad {
  /**
   * @param {{client, core: () => import('../wasm/pool.js').CorePool, normals, onBytes?: (n: number) => void, hold?: () => Promise<void>|null,
   *          look: () => object|null, onPart: (part: PartObject) => Promise<boolean>}} options
   *   look: see lookOrder; onPart: draws it, resolves when it has grown; false: something else is drawn by now, and no more parts are wanted
   */
  constructor(options) {
    this.options = options;
    this.wanted = true;
    this.drawing = null;
    this.last = null;
  }

  /** From the level `base` ({id: in the worker, object}) by `units` (of a manifest's delta). */
  async run(base, units, signal) {
    const { client, onBytes, hold } = this.options;
    const pool = this.options.core();
    const head = await client.part(units.object, 0, units.first, { signal, onBytes, hold });
    const step = await pool.unitsOpen(head, base.id);
    try {
      if (step.size !== units.bytes) throw new ProtocolError('The units are not those that the description tells of.', { kind: 'malformed' });
      const { offset, bytes } = step.patches[step.first];
      await pool.unitsDecode(step.id, step.first, head.slice(offset, offset + bytes));
      await this.rest(step, base, units, signal);
      await this.drawing;
      return await this.finish(step, base, units);
    } catch (error) {
      await this.drawing?.catch(() => {});
      throw error;
    } finally {
      pool.unitsFree(step.id);
    }
  }

  async rest(step, base, units, signal) {
    const { client, onBytes, hold, look } = this.options;
    const pool = this.options.core();
    const lacking = new Set(step.patches.keys());
    lacking.delete(step.first);
    for (const p of lacking) if (step.patches[p].bytes === 0) lacking.delete(p);
    const size = units.bytes / DRAWINGS;
    while (lacking.size > 0) {
      const order = lookOrder(step.patches, [...lacking], look());
      await Promise.all(batches(step.patches, order, size).map(async ({ from, to, patches }) => {
        const bytes = await client.part(units.object, from, to, { signal, onBytes, hold });
        for (const p of patches) {
          const { offset, bytes: length } = step.patches[p];
          await pool.unitsDecode(step.id, p, bytes.subarray(offset - from, offset - from + length).slice());
          lacking.delete(p);
        }
      }));
      signal.throwIfAborted();
      if (lacking.size > 0 && this.wanted && this.drawing === null) {
        this.drawing = this.part(step, base).catch(() => (this.wanted = false)).finally(() => (this.drawing = null));
      }
    }
  }

  /** What has come, drawn. */
  async part(step, base) {
    if (!morphable(base.object)) return;
    const { object, shape } = await this.draw(step, base);
    object.dispose();
    const part = new PartObject(shape, base.object, this.last);
    this.last = part;
    if (await this.options.onPart(part)) return;
    this.wanted = false;
    this.last = null;
    part.dispose();
  }

  /** {object: what has come as a level, id: in the worker, shape: MorphObject that leads there from what is drawn}. */
  async draw(step, base) {
    const pool = this.options.core();
    const joined = await pool.unitsJoin(step.id);
    let to = null;
    try {
      const object = await levelFromArrays([joined.arrays], base.object, this.options.normals);
      const coarse = describeLevel(base.object);
      const fine = describeLevel(object);
      const { layout, values, from, end } = fine.beside(coarse);
      to = await pool.level(fine.arrays.position, fine.index, fine.materials);
      const drawn = await pool.unitsDraw(step.id, to, { values, coarse: from, fine: end });
      return { object, id: joined.id, shape: new MorphObject(drawn, layout, values, fine, coarse) };
    } catch (error) {
      pool.free(joined.id);
      throw error;
    } finally {
      if (to !== null) pool.free(to);
    }
  }

  /** The finer level, with what leads to it from what is drawn (null: nothing of it is). */
  async finish(step, base, units) {
    const pool = this.options.core();
    const { last } = this;
    if (last && this.wanted) {
      const { object, id, shape } = await this.draw(step, base);
      return { object, id, bytes: units.bytes, morph: { after: last, shape } };
    }
    const joined = await pool.unitsJoin(step.id);
    const object = await levelFromArrays([joined.arrays], base.object, this.options.normals);
    return { object, id: joined.id, bytes: units.bytes, morph: null };
  }
}

/** What is drawn of a level of which some patches are finer; the interface of LevelObject. */
export class PartObject {
  /** after: the PartObject that it grows out of, or null: out of the level `base` */
  constructor(shape, base, after) {
    this.shape = shape;
    this.base = base;
    this.after = after;
    this.transient = true;
    this.root = new Group();
    this.root.add(new Mesh(shape.geometry, shape.materials));
    this.root.children[0].frustumCulled = false;
    this.fade = shape.fade;
    this.viewportHeight = shape.viewportHeight;
    this.triangles = shape.triangles;
    this.bars = 0;
    this.bytes = shape.bytes;
  }

  /** Whether it leads on from what is drawn. */
  follows(shown) {
    return shown === (this.after ?? this.base);
  }

  /** As MorphObject, but what it draws stays when the morph is over. */
  get morph() {
    const { root, shape } = this;
    return {
      root,
      t: shape.t,
      triangles: shape.triangles,
      setWireframe: (on) => shape.setWireframe(on),
      dispose: () => {
        shape.t.value = 1;
        root.removeFromParent();
      },
    };
  }

  setWireframe(on) {
    this.shape.setWireframe(on);
  }

  dispose() {
    this.root.removeFromParent();
    this.shape.dispose();
  }
}
