/* For native clients: frames in as they arrive, levels out, and what is drawn between two levels.
 *
 * Link libcodec's stream, core/mesh and core/base; nothing else is needed, no thread is started, and hostile bytes end in a status. An
 * example is example.c. The bytes come from GET /v1/models/{id}/delta (codec/FORMAT.md, section 6); a client that begins with a level's GLB
 * gives lodestream_start the mesh that it decoded, positions and triangles, in any order. */
#ifndef LOD_CLIENTS_NATIVE_LODESTREAM_H
#define LOD_CLIENTS_NATIVE_LODESTREAM_H

#include "codec/stream/delta.h"
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

#endif
