/* A bare Draco mesh (.drc): the first attribute of each kind. */
#include "codec/export/draco.h"
#include "codec/import/reader.h"

/* The first attribute of a kind with a fitting number of components, as floats; NULL when there is none. */
static enum lod_status read_kind(struct lod_reader *reader, const struct lod_draco_mesh *draco, enum lod_draco_kind kind, int skip,
                                 int least, int most, float **values, int *components) {
  *values = NULL;
  for (uint32_t i = 0; i < draco->attribute_count; i++) {
    struct lod_draco_attribute attribute = draco->attributes[i];
    if (attribute.kind != kind || attribute.components < least || attribute.components > most || skip-- > 0)
      continue;
    /* Colours are integers of which some writers forget to say that they are normalised. */
    if (kind == LOD_DRACO_COLOR && attribute.component != LOD_DRACO_FLOAT)
      attribute.normalized = true;
    *components = attribute.components;
    *values = lod_draco_floats(draco, &attribute, reader->scratch);
    return *values ? LOD_OK : lod_reader_memory(reader);
  }
  return LOD_OK;
}

static enum lod_status read_colors(struct lod_reader *reader, const struct lod_draco_mesh *draco, struct lod_mesh *mesh) {
  float *values;
  int components;
  LOD_TRY(read_kind(reader, draco, LOD_DRACO_COLOR, 0, 3, 4, &values, &components));
  if (!values)
    return LOD_OK;
  mesh->colors = lod_arena_alloc(reader->scratch, mesh->vertex_count, sizeof *mesh->colors);
  if (!mesh->colors)
    return lod_reader_memory(reader);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int k = 0; k < 4; k++) {
      float value = k < components ? values[(size_t)v * (size_t)components + (size_t)k] : 1;
      mesh->colors[v][k] = k < 3 ? lod_linear_from_srgb(value >= 0 && value <= 1 ? value : 1) : value;
    }
  return LOD_OK;
}

enum lod_status lod_import_draco(struct lod_reader *reader) {
  struct lod_draco_limits limits = {reader->limits.max_vertices, reader->limits.max_triangles};
  struct lod_draco_mesh draco;
  struct lod_problem problem = {0};
  enum lod_status status = lod_draco_decode(reader->bytes, reader->size, &limits, reader->scratch, &draco, &problem);
  if (status != LOD_OK)
    return lod_reader_fail(reader, status, problem.type, "%s", problem.detail);
  LOD_TRY(lod_reader_add_vertices(reader, draco.point_count));
  LOD_TRY(lod_reader_add_triangles(reader, draco.triangle_count));
  struct lod_mesh mesh = {.vertex_count = draco.point_count, .triangle_count = draco.triangle_count, .triangles = draco.triangles};
  float *values;
  int components;
  LOD_TRY(read_kind(reader, &draco, LOD_DRACO_POSITION, 0, 3, 3, &values, &components));
  if (!values)
    return lod_reader_bad(reader, "bad-draco", "there are no positions of three components");
  mesh.positions = (float(*)[3])(void *)values;
  LOD_TRY(read_kind(reader, &draco, LOD_DRACO_NORMAL, 0, 3, 3, &values, &components));
  mesh.normals = (float(*)[3])(void *)values;
  for (int set = 0; set < LOD_UV_SETS; set++) {
    LOD_TRY(read_kind(reader, &draco, LOD_DRACO_TEXCOORD, set, 2, 2, &values, &components));
    mesh.uvs[set] = (float(*)[2])(void *)values;
    for (uint32_t v = 0; values && v < mesh.vertex_count; v++)
      mesh.uvs[set][v][1] = 1 - mesh.uvs[set][v][1];
  }
  LOD_TRY(read_colors(reader, &draco, &mesh));
  if (lod_scene_share_index(&mesh, reader->scratch) != LOD_OK)
    return lod_reader_memory(reader);
  struct lod_scene_part part = {.mesh = mesh};
  return lod_scene_add_part(reader->scene, &part, reader->name, reader->problem);
}
