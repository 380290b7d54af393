/* Files of deltas, applied to a model in memory. */
#ifndef LOD_CLIENTS_CLI_DELTAS_H
#define LOD_CLIENTS_CLI_DELTAS_H

#include "clients/cli/cli.h"

/* Whether a file begins like a delta. False also when it cannot be read. */
bool cli_is_delta(const char *path);

/* Applies every frame of the file. based: `model` holds the level that the first ones start from; else they are first pictures and make the
 * model: a part a unit, each placed once. */
LOD_WARN_UNUSED enum lod_status cli_apply_deltas(const char *path, bool based, struct lod_model *model, struct lod_arena *arena,
                                                 struct lod_problem *problem);

#endif
