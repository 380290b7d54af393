/* Every model of the shared corpus, where there is one: right counts, or a problem that says why not. */
#include <fcntl.h>
#include <libgen.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tests/unit/codec/import/importing.h"

#if defined(__SANITIZE_ADDRESS__)
#define SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define SANITIZED 1
#endif
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

enum { kPath = 0, kRole = 2, kVertices = 3, kTriangles = 4, kWelded = 6, kColumns = 12 };

static const char *models_folder(void) {
  static char folder[512];
  const char *shared = getenv("LODESTREAM_SHARED");
  snprintf(folder, sizeof folder, "%s/models", shared ? shared : "../shared");
  return folder;
}

static uint8_t *read_all(const char *path, size_t *size) {
  FILE *file = fopen(path, "rb");
  if (!file)
    return NULL;
  struct stat status;
  assert_int_equal(fstat(fileno(file), &status), 0);
  *size = (size_t)status.st_size;
  uint8_t *bytes = malloc(*size ? *size : 1);
  assert_int_equal(fread(bytes, 1, *size, file), *size);
  fclose(file);
  return bytes;
}

struct result {
  bool read; /* false: not there, or too large for the sanitizers */
  enum lod_status status;
  struct lod_problem problem;
  uint64_t vertices, triangles, welded;
};

static struct result import_path(const char *relative) {
  struct result result = {0};
  char path[1024], folder[1024];
  size_t size = 0;
  snprintf(path, sizeof path, "%s/%s", models_folder(), relative);
  snprintf(folder, sizeof folder, "%s", path);
  struct stat status;
  if (stat(path, &status) != 0 || (SANITIZED && status.st_size > 8 << 20))
    return result;
  uint8_t *bytes = read_all(path, &size);
  int directory = open(dirname(folder), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  struct lod_import_files files = lod_import_files_beneath(&directory);
  struct lod_arena *arena = lod_arena_create((size_t)2 << 30);
  struct lod_model model;
  const char *name = strrchr(relative, '/');
  struct lod_import_request request = {.name = name + 1, .bytes = bytes, .size = size, .files = &files, .threads = 1};
  result.read = true;
  result.status = lod_import_model(&request, arena, &model, &result.problem);
  result.vertices = model.source_vertices;
  result.triangles = model.source_triangles;
  for (uint32_t u = 0; u < model.unit_count; u++) {
    struct lod_problem problem = {0};
    if (!lod_mesh_check(&model.units[u].mesh, &problem))
      fail_msg("%s: %s", relative, problem.detail);
    result.welded += model.units[u].mesh.vertex_count;
  }
  lod_arena_destroy(arena);
  close(directory);
  free(bytes);
  return result;
}

static bool has_ending(const char *path, const char *ending) {
  size_t n = strlen(path), tail = strlen(ending);
  return n >= tail && strcmp(path + n - tail, ending) == 0;
}

static bool is_model(const char *path) {
  static const char *const kEndings[] = {".glb", ".gltf", ".ply", ".stl", ".obj", ".off", ".m", ".drc"};
  for (size_t i = 0; i < sizeof kEndings / sizeof *kEndings; i++)
    if (has_ending(path, kEndings[i]))
      return true;
  return false;
}

/* The manifest counts all meshes of these files, we those of the default scene. */
static bool counts_differ(const char *path) {
  return strstr(path, "MultipleScenes") || strstr(path, "town_model");
}

/* Vertices that no face uses count in the manifest and are gone after the weld. */
static bool has_loose_vertices(const char *path) {
  return strstr(path, "bunny.ply") || strstr(path, "bun_zipper") || strstr(path, "dead-tree");
}

static void check_row(char *columns[kColumns], bool *failed) {
  const char *path = columns[kPath];
  bool negative = strncmp(path, "invalid/", 8) == 0;
  struct result result = import_path(path);
  if (!result.read)
    return;
  if (result.status != LOD_OK && (result.problem.type[0] == 0 || result.problem.detail[0] == 0)) {
    print_error("%s: refused without a sentence\n", path);
    *failed = true;
  }
  if (negative || counts_differ(path))
    return;
  uint64_t triangles = strtoull(columns[kTriangles], NULL, 10), welded = strtoull(columns[kWelded], NULL, 10);
  bool gltf = has_ending(path, ".glb") || has_ending(path, ".gltf");
  bool right = result.status == LOD_OK && (triangles == 0 || result.triangles == triangles) &&
               (gltf || welded == 0 || result.welded == welded || (has_loose_vertices(path) && result.welded < welded));
  if (!right) {
    print_error("%s: %s %s; %llu triangles for %llu, %llu vertices for %llu\n", path, lod_status_name(result.status), result.problem.detail,
                (unsigned long long)result.triangles, (unsigned long long)triangles, (unsigned long long)result.welded,
                (unsigned long long)welded);
    *failed = true;
  }
}

static void every_model_has_the_manifests_counts_and_every_broken_file_a_verdict(void **state) {
  (void)state;
  char path[600], line[8192];
  bool failed = false;
  snprintf(path, sizeof path, "%s/MANIFEST.tsv", models_folder());
  FILE *manifest = fopen(path, "r");
  if (!manifest)
    return;
  while (fgets(line, sizeof line, manifest)) {
    char *columns[kColumns] = {0}, *rest = line;
    int count = 0;
    while (count < kColumns && (columns[count] = strsep(&rest, "\t\n")))
      count++;
    bool binary_or_large = strncmp(columns[kPath], "large/", 6) == 0 || strncmp(columns[kPath], "acceptance", 10) == 0;
    if (count == kColumns && is_model(columns[kPath]) && !binary_or_large)
      check_row(columns, &failed);
  }
  fclose(manifest);
  assert_false(failed);
}

static void broken_files_are_refused_for_the_right_reason(void **state) {
  (void)state;
  static const struct {
    const char *path, *type; /* NULL: imports */
  } kVerdicts[] = {
      {"invalid/mutated/cow-count-lies.ply", "truncated"},
      {"invalid/mutated/cow-truncated.ply", "truncated"},
      {"invalid/mutated/duck-corrupt-png.glb", NULL},
      {"invalid/mutated/duck-count-1e9.glb", "truncated"},
      {"invalid/mutated/duck-index-65534.glb", "index-out-of-range"},
      {"invalid/mutated/duck-json-chunk-huge.glb", "truncated"},
      {"invalid/mutated/duck-nan-inf-positions.glb", "non-finite"},
      {"invalid/mutated/duck-path-traversal.glb", "unsafe-uri"},
      {"invalid/mutated/duck-self-child.glb", "node-cycle"},
      {"invalid/mutated/duck-truncated-half.glb", "truncated"},
      {"invalid/mutated/duck-truncated-header.glb", "truncated"},
      {"invalid/mutated/duck-unknown-required-ext.glb", "unsupported-extension"},
      {"invalid/mutated/duck-wrong-total-length.glb", "truncated"},
      {"invalid/gltf1/BoxTextured-v1.gltf", "unsupported-version"},
      {"invalid/crlf-mangled/gears.glb", "truncated"},
      {"invalid/tinygltf/zero-sized-bin-chunk-issue-440.glb", NULL},
      {"invalid/tinygltf/invalid-primitive-indices.gltf", "index-out-of-range"},
      {"invalid/assimp/BoxBadNormals-glTF-Binary/BoxBadNormals.glb", NULL},
      {"invalid/assimp/IndexOutOfRange/IndexOutOfRange.gltf", "index-out-of-range"},
      {"invalid/assimp/MissingBin/BoxTextured.gltf", "missing-file"},
      {"invalid/assimp/OutOfMemory.off", "truncated"},
      {"invalid/assimp/empty.obj", "empty"},
      {"invalid/assimp/empty.ply", "empty"},
      {"invalid/gltf-validator/base/glb/extra_data.glb", "empty"},
      {"invalid/gltf-validator/base/mesh/valid.gltf", NULL},
      {"invalid/gltf-validator/base/mesh/unresolved_material.gltf", "index-out-of-range"},
  };
  for (size_t i = 0; i < sizeof kVerdicts / sizeof *kVerdicts; i++) {
    struct result result = import_path(kVerdicts[i].path);
    const char *type = result.status == LOD_OK ? NULL : result.problem.type;
    if (result.read && (type == NULL) != (kVerdicts[i].type == NULL))
      fail_msg("%s: %s", kVerdicts[i].path, result.problem.detail);
    if (result.read && type)
      assert_string_equal(type, kVerdicts[i].type);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_model_has_the_manifests_counts_and_every_broken_file_a_verdict),
      cmocka_unit_test(broken_files_are_refused_for_the_right_reason),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
