/* For native clients: frames in as they arrive, levels out, and what is drawn between two levels.
 *
 * Link libcodec's stream, core/mesh and core/base; nothing else is needed, no thread is started, and hostile bytes end in a status. An
 * example is example.c. The bytes come from GET /v1/models/{id}/delta (codec/FORMAT.md, section 6); a client that begins with a level's GLB
 * gives lodestream_start the mesh that it decoded, positions and triangles, in any order. */
#ifndef LOD_CLIENTS_NATIVE_LODESTREAM_H
#define LOD_CLIENTS_NATIVE_LODESTREAM_H

#include "codec/stream/units.h"
#include "core/mesh/overlay.h"

/* One unit of a model on its way from coarse to fine. Not for two threads at once. */
struct lodestream;

/* memory: the most that it holds at once, in bytes; 0 = no limit. NULL when memory is out. */
struct lodestream *lodestream_create(size_t memory);
void lodestream_destroy(struct lodestream *stream); /* NULL is allowed */

/* The level to start from; not needed where the first frame is a first picture. The mesh is copied. */
LOD_WARN_UNUSED enum lod_status lodestream_start(struct lodestream *stream, const struct lod_mesh *level, struct lod_problem *problem);

/* Bytes that came, `size` of them; *used: how many were taken: whole frames only, so keep the rest and give it again with what follows it.
 * Takes at most one frame a call: *used is 0 when the first one is not whole yet. After a failure the stream is still at its last good
 * level; *used then is the length of the bad frame, 0 where that cannot be known. Frames of other units are for other streams: unit is the
 * one that this stream takes, others are stepped over. */
LOD_WARN_UNUSED enum lod_status lodestream_feed(struct lodestream *stream, uint32_t unit, const uint8_t *bytes, size_t size, size_t *used,
                                                struct lod_problem *problem);

/* The level reached, or NULL before any; valid until the next feed. */
const struct lod_mesh *lodestream_level(const struct lodestream *stream);

/* Triangles whose corners go from the level before (start) to the level reached (end); at t a corner is start + t (end - start): with t = 0
 * the coarser level's shape wherever it could be mapped, with t = 1 the finer's. NULL *morph and LOD_OK where there was no step. Valid
 * until the next feed. */
LOD_WARN_UNUSED enum lod_status lodestream_morph(struct lodestream *stream, const struct lod_morph **morph, struct lod_problem *problem);

/* ---- a step in units: the part that one looks at first ----
 *
 * A manifest's `delta.units` names an object that holds the step in parts (codec/FORMAT.md, section 6.3). Ask for its first `units.first`
 * bytes with Range and give them to lodestream_units_begin; lodestream_units then tells of every patch where its frame lies, and a ball
 * around it and which way it faces, by which a client chooses what to ask for next. The frame of header.primer_patch lies in those first
 * bytes and is taken first, all others in any order. As they come, draw lodestream_units_morph; with all of them
 * lodestream_units_finish makes the finer level the level reached. */

/* bytes: the index, more may follow (lod_units_index_bytes tells how long it is). They are not needed afterwards. A step in units that had
 * begun before is dropped. After a failure ("wrong-base" too: the level reached is not the step's coarser one) that one goes on. */
LOD_WARN_UNUSED enum lod_status lodestream_units_begin(struct lodestream *stream, const uint8_t *bytes, size_t size,
                                                       struct lod_problem *problem);

/* Index and patches; NULL where no step in units has begun. Valid until it ends. */
const struct lod_units *lodestream_units(const struct lodestream *stream);

/* A patch's frame: `size` at least patches[patch].size. One that is at hand already is not decoded again. After a failure nothing has
 * changed, and the frame can be asked for anew. */
LOD_WARN_UNUSED enum lod_status lodestream_units_take(struct lodestream *stream, uint32_t patch, const uint8_t *bytes, size_t size,
                                                      struct lod_problem *problem);

/* What to draw of the patches at hand: fragments where all patches around are here, the level reached elsewhere, without cracks at any t.
 * What was fragments in the drawing before is at its end whatever t (settled), so each part grows once, and a drawing is made when the one
 * before has grown (t = 1). With all patches its end is the finer level. Valid until the next one, or until the step ends. */
LOD_WARN_UNUSED enum lod_status lodestream_units_morph(struct lodestream *stream, const struct lod_morph **morph,
                                                       struct lod_problem *problem);

/* All patches are at hand: the finer level, whose checksum is compared, is the level reached, and the step ends. After a failure the stream
 * is at its coarser level as before. */
LOD_WARN_UNUSED enum lod_status lodestream_units_finish(struct lodestream *stream, struct lod_problem *problem);

/* The step ends at the level reached. feed and start do that too. */
void lodestream_units_drop(struct lodestream *stream);

#endif
