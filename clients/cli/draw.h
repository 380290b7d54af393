/* A model as a PNG. */
#ifndef LOD_CLIENTS_CLI_DRAW_H
#define LOD_CLIENTS_CLI_DRAW_H

#include "core/mesh/model.h"

/* size: pixels each way. */
LOD_WARN_UNUSED enum lod_status cli_draw_model(const struct lod_model *model, const char *path, uint32_t size, bool wireframe,
                                               struct lod_arena *arena, struct lod_problem *problem);

#endif
