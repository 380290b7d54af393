/* A whole model as one mesh in model space: for measuring and drawing, not for simplification. */
#ifndef LOD_CORE_MESH_FLATTEN_H
#define LOD_CORE_MESH_FLATTEN_H

#include "core/mesh/model.h"

/* Every instance of every part, in one mesh with parts and materials tagged; attributes that only some units have are filled (normals 0 0
 * 0, UV 0 0, colour 1 1 1 1). *rounding: bound on how far storing transformed positions as float moved any of them, model units. Limits:
 * LOD_LIMIT when the instances add up to more than 2^32 - 2 of anything. */
LOD_WARN_UNUSED enum lod_status lod_model_flatten(const struct lod_model *model, struct lod_arena *arena, struct lod_mesh *mesh,
                                                  double *rounding, struct lod_problem *problem);

#endif
