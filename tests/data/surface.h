/* What of a mesh's topology re-tiling promises to keep: that of its triangles taken once each, whichever way they look. */
#ifndef LOD_TESTS_DATA_SURFACE_H
#define LOD_TESTS_DATA_SURFACE_H

#include "core/mesh/topology.h"

/* Of the triangles without those that have the same three corners as one before, or name a corner twice. Aborts when memory is out. */
struct lod_topology lod_surface_topology(const struct lod_mesh *mesh, struct lod_arena *arena);
bool lod_surface_same(const struct lod_topology *a, const struct lod_topology *b); /* Euler number, components, loops, edges of three */

#endif
