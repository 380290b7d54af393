/* Deep copies of meshes. */
#ifndef LOD_CORE_MESH_COPY_H
#define LOD_CORE_MESH_COPY_H

#include "core/mesh/mesh.h"

/* Every array anew in `arena`. Fails with LOD_MEMORY alone. */
LOD_WARN_UNUSED enum lod_status lod_mesh_copy(const struct lod_mesh *mesh, struct lod_arena *arena, struct lod_mesh *copy);

#endif
