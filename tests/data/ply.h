/* A reader for the corpus: binary little-endian PLY with float x, y, z first in a vertex and triangles as `list uchar int`. Tests and
 * benchmarks only; the importer proper is codec/import. */
#ifndef LOD_TESTS_DATA_PLY_H
#define LOD_TESTS_DATA_PLY_H

#include "core/mesh/mesh.h"

/* Positions and triangles as they stand in the file. False when the file is missing or not of that kind. Aborts when memory is out. */
bool lod_ply_read(const char *path, struct lod_arena *arena, struct lod_mesh *mesh);

/* The folder of shared test data: $LODESTREAM_SHARED, else ../shared; NULL when there is none. */
const char *lod_shared_folder(void);

#endif
