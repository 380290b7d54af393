/* Files of curved patches on the command line. */
#ifndef LOD_CLIENTS_CLI_PATCHES_H
#define LOD_CLIENTS_CLI_PATCHES_H

#include "core/mesh/mesh.h"

/* Whether the file begins as application/vnd.lodestream.patches does. */
bool cli_is_patches(const char *path);

/* All frames of the file as triangles in one mesh, each frame within a tenth of the error that it tells of itself (1e-4 of its size where
 * it tells none). Units lie where they lie in their own space. */
LOD_WARN_UNUSED enum lod_status cli_tessellate(const char *path, struct lod_arena *arena, struct lod_mesh *mesh,
                                               struct lod_problem *problem);

#endif
