#include "clients/cli/draw.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "codec/export/png.h"
#include "core/mesh/flatten.h"

static enum lod_status write_picture(const struct lod_picture *picture, const char *path, struct lod_problem *problem) {
  FILE *out = fopen(path, "wb");
  if (out == NULL)
    return lod_fail(problem, LOD_IO, "write-failed", "Cannot write %s: %s.", path, strerror(errno));
  enum lod_status status = lod_png_write(picture, out, problem);
  if (fclose(out) != 0 && status == LOD_OK)
    status = lod_fail(problem, LOD_IO, "write-failed", "Cannot write %s: %s.", path, strerror(errno));
  if (status != LOD_OK)
    unlink(path);
  return status;
}

enum lod_status cli_draw_model(const struct lod_model *model, const char *path, uint32_t size, bool wireframe, struct lod_arena *arena,
                               struct lod_problem *problem) {
  struct lod_mesh mesh;
  double rounding;
  struct lod_picture picture;
  LOD_TRY(lod_model_flatten(model, arena, &mesh, &rounding, problem));
  struct lod_picture_settings settings = lod_picture_defaults();
  settings.width = settings.height = size;
  settings.wireframe = wireframe;
  LOD_TRY(lod_picture_render(&mesh, 1, &settings, arena, &picture, problem));
  return write_picture(&picture, path, problem);
}
