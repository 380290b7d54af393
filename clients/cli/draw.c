#include "clients/cli/draw.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "codec/export/png.h"
#include "core/mesh/flatten.h"
#include "core/mesh/mesh.h"

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

/* All units in one space, as one surface. */
static enum lod_status flatten(const struct lod_model *model, bool welded, struct lod_arena *arena, struct lod_mesh *mesh,
                               struct lod_problem *problem) {
  struct lod_mesh whole;
  double rounding;
  LOD_TRY(lod_model_flatten(model, arena, &whole, &rounding, problem));
  if (!welded) {
    *mesh = whole;
    return LOD_OK;
  }
  return lod_mesh_weld(&whole, arena, mesh, NULL) == LOD_OK ? LOD_OK : lod_fail_memory(problem);
}

enum lod_status cli_draw_model(const struct lod_model *model, const struct cli_drawing *drawing, struct lod_arena *arena,
                               struct lod_problem *problem) {
  struct lod_mesh mesh, source;
  struct lod_picture picture;
  bool plain = drawing->kind == LOD_PICTURE_SHADED || drawing->kind == LOD_PICTURE_WIREFRAME;
  struct lod_picture_scene scene = {
      .kind = drawing->kind, .mesh = &mesh, .t = drawing->t, .reach = drawing->reach, .vertices = drawing->vertices};
  LOD_TRY(flatten(model, !plain, arena, &mesh, problem));
  if (drawing->source != NULL) {
    LOD_TRY(flatten(drawing->source, true, arena, &source, problem));
    scene.source = &source;
  }
  struct lod_picture_settings settings = lod_picture_defaults();
  settings.width = settings.height = drawing->size;
  LOD_TRY(lod_picture_render_scene(&scene, settings, arena, &picture, problem));
  return write_picture(&picture, drawing->path, problem);
}
