/* Edges that a user wants to keep (Varshney et al. 1995, 6.5), from a text file (codec/FORMAT.md, section 8). */
#ifndef LOD_SERVER_WORKER_EDGES_H
#define LOD_SERVER_WORKER_EDGES_H

#include "core/envelope/envelope.h"
#include "core/mesh/model.h"

/* name: of the file, for messages; text: its `size` bytes. *wishes: one a unit, the edges of the first, which holds all parts that occur
 * once. Fails with LOD_BAD_INPUT, which tells the line and what was expected there, or LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_edges_read(const char *name, const char *text, size_t size, const struct lod_model *model,
                                               struct lod_arena *arena, struct lod_envelope_wishes **wishes, struct lod_problem *problem);

#endif
