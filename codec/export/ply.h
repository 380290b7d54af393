/* A mesh as binary little-endian PLY, for `lodestream decode` and for other programs.
 *
 * Vertices: float x y z, and where the mesh has them float nx ny nz, float s t (UV set 0, t upwards as PLY readers expect), uchar red
 * green blue alpha (sRGB). A vertex with several wedges becomes one PLY vertex a wedge. Faces: list uchar int vertex_indices. Free edges:
 * element edge, int vertex1 vertex2, float thickness. Free points are vertices that nothing refers to. */
#ifndef LOD_CODEC_EXPORT_PLY_H
#define LOD_CODEC_EXPORT_PLY_H

#include <stdio.h>

#include "core/mesh/mesh.h"

/* comment: one line for the header, or NULL. LOD_IO when the file cannot be written, LOD_LIMIT over 2^31 - 1 vertices, LOD_MEMORY. */
LOD_WARN_UNUSED enum lod_status lod_ply_write(const struct lod_mesh *mesh, const char *comment, FILE *file, struct lod_problem *problem);

/* The same to bytes in `arena`. */
LOD_WARN_UNUSED enum lod_status lod_ply_encode(const struct lod_mesh *mesh, const char *comment, struct lod_arena *arena, uint8_t **bytes,
                                               size_t *size, struct lod_problem *problem);

#endif
