#include "codec/import/import.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "codec/import/reader.h"
#include "codec/import/text.h"

struct lod_import_limits lod_import_limits_defaults(void) {
  return (struct lod_import_limits){
      .max_bytes = 2ull << 30,
      .max_vertices = 200000000,
      .max_triangles = 200000000,
      .max_instances = 1000000,
      .max_depth = 256,
      .max_texture_pixels = 16384,
      .max_texture_bytes = 256ull << 20,
  };
}

static struct lod_import_limits resolve_limits(const struct lod_import_limits *given) {
  struct lod_import_limits limits = given ? *given : lod_import_limits_defaults();
  /* lod_mesh counts in 32 bits, LOD_NONE excluded, and the json reader has its own depth limit. */
  const uint64_t largest = UINT32_MAX / 4;
  if (limits.max_bytes == 0)
    limits.max_bytes = UINT64_MAX;
  if (limits.max_vertices == 0 || limits.max_vertices > largest)
    limits.max_vertices = largest;
  if (limits.max_triangles == 0 || limits.max_triangles > largest)
    limits.max_triangles = largest;
  if (limits.max_instances == 0)
    limits.max_instances = UINT32_MAX - 1;
  if (limits.max_depth == 0 || limits.max_depth > 1024)
    limits.max_depth = 1024;
  if (limits.max_texture_pixels == 0)
    limits.max_texture_pixels = UINT32_MAX;
  if (limits.max_texture_bytes == 0)
    limits.max_texture_bytes = UINT64_MAX;
  return limits;
}

enum lod_status lod_reader_fail(struct lod_reader *reader, enum lod_status status, const char *type, const char *format, ...) {
  char sentence[400];
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(sentence, sizeof sentence, format, arguments);
  va_end(arguments);
  status = lod_fail(reader->problem, status, type, "%.120s: %s", reader->name, sentence);
  lod_text_clean(reader->problem->detail);
  return status;
}

enum lod_status lod_reader_memory(struct lod_reader *reader) {
  return lod_fail_memory(reader->problem);
}

static enum lod_status add(struct lod_reader *reader, uint64_t *count, uint64_t more, uint64_t limit, const char *type, const char *what) {
  if (more > limit || *count > limit - more)
    return lod_reader_fail(reader, LOD_LIMIT, type, "more than %llu %s, the limit of this import", (unsigned long long)limit, what);
  *count += more;
  return LOD_OK;
}

enum lod_status lod_reader_add_vertices(struct lod_reader *reader, uint64_t more) {
  return add(reader, &reader->vertices, more, reader->limits.max_vertices, "limit-vertices", "vertices");
}
enum lod_status lod_reader_add_triangles(struct lod_reader *reader, uint64_t more) {
  return add(reader, &reader->triangles, more, reader->limits.max_triangles, "limit-triangles", "triangles");
}
enum lod_status lod_reader_add_instances(struct lod_reader *reader, uint64_t more) {
  return add(reader, &reader->instances, more, reader->limits.max_instances, "limit-instances", "instances");
}
enum lod_status lod_reader_add_bytes(struct lod_reader *reader, uint64_t more) {
  return add(reader, &reader->bytes_read, more, reader->limits.max_bytes, "limit-bytes", "bytes in the file and what it refers to");
}

enum lod_status lod_reader_progress(struct lod_reader *reader, double fraction) {
  lod_progress_report(reader->progress, "import", fraction);
  if (lod_progress_cancelled(reader->progress))
    return lod_reader_fail(reader, LOD_CANCELLED, "cancelled", "import was cancelled");
  return LOD_OK;
}

/* What is not listed goes to assimp. */
static const struct {
  const char *format;
  enum lod_status (*read)(struct lod_reader *reader);
} kReaders[] = {
    {"glb", lod_import_gltf},    {"gltf", lod_import_gltf},   {"ply", lod_import_ply},    {"stl", lod_import_stl},
    {"m", lod_import_hoppe},     {"obj", lod_import_obj},     {"drc", lod_import_draco},  {"bpt", lod_import_patches},
    {"bez", lod_import_patches}, {"bbp", lod_import_patches}, {"bv", lod_import_patches}, {"rib", lod_import_rib},
    {"off", lod_import_off},
};

static enum lod_status read_with(struct lod_reader *reader) {
  for (size_t i = 0; i < sizeof kReaders / sizeof *kReaders; i++)
    if (strcmp(reader->format, kReaders[i].format) == 0)
      return kReaders[i].read(reader);
  return lod_import_assimp(reader);
}

static enum lod_status import_with_scratch(struct lod_reader *reader, struct lod_model *model) {
  reader->scene = lod_scene_create(reader->scratch, reader->arena);
  if (!reader->scene)
    return lod_reader_memory(reader);
  LOD_TRY(lod_reader_add_bytes(reader, reader->size));
  LOD_TRY(lod_reader_progress(reader, 0));
  if (reader->size == 0)
    return lod_reader_bad(reader, "empty", "the file has no bytes");
  if (!reader->format)
    return lod_reader_fail(reader, LOD_UNSUPPORTED, "unknown-format",
                           "neither the content nor the name says which format this is; expected glTF, PLY, STL, OBJ, OFF, FBX, ..., "
                           "or a name that ends in the format (.bv, .dxf, ...)");
  LOD_TRY(read_with(reader));
  LOD_TRY(lod_reader_progress(reader, 0.5));
  uint64_t source_vertices = reader->source_vertices ? reader->source_vertices : reader->vertices;
  LOD_TRY(lod_scene_finish(reader->scene, source_vertices, reader->name, model, reader->problem));
  model->format = lod_arena_copy(reader->arena, reader->format, strlen(reader->format));
  if (!model->format)
    return lod_reader_memory(reader);
  return lod_reader_progress(reader, 1);
}

enum lod_status lod_import_model(const struct lod_import_request *request, struct lod_arena *arena, struct lod_model *model,
                                 struct lod_problem *problem) {
  *model = (struct lod_model){0};
  struct lod_problem own = {0};
  struct lod_reader reader = {
      .name = request->name && request->name[0] ? request->name : "model",
      .bytes = request->bytes,
      .size = request->size,
      .files = request->files,
      .limits = resolve_limits(request->limits),
      .progress = request->progress,
      .threads = request->threads,
      .arena = arena,
      .problem = problem ? problem : &own,
  };
  reader.format = request->format ? request->format : lod_import_sniff(request->bytes, request->size, request->name);
  reader.scratch = lod_arena_create_child(arena);
  if (!reader.scratch)
    return lod_fail_memory(problem);
  enum lod_status status = import_with_scratch(&reader, model);
  lod_arena_destroy(reader.scratch);
  if (status != LOD_OK)
    *model = (struct lod_model){0};
  return status;
}
