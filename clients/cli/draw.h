/* A model as a PNG. */
#ifndef LOD_CLIENTS_CLI_DRAW_H
#define LOD_CLIENTS_CLI_DRAW_H

#include "codec/export/picture_scene.h"
#include "core/mesh/model.h"

struct cli_drawing {
  const char *path;
  uint32_t size; /* pixels each way */
  enum lod_picture_kind kind;
  const struct lod_model *source; /* of pictures that compare: the source, or the finer level; or NULL */
  double t, reach;                /* as in picture_scene.h */
  uint32_t vertices;
};

LOD_WARN_UNUSED enum lod_status cli_draw_model(const struct lod_model *model, const struct cli_drawing *drawing, struct lod_arena *arena,
                                               struct lod_problem *problem);

#endif
