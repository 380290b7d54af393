/* What must hold for every mesh: the topology stays, levels are nested, maps are valid. Random shapes with holes, bow ties, fins and
 * creases; and the shared models where they are. */
#include <dirent.h>
#include <fcntl.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

#include "codec/import/import.h"
#include "core/mesh/overlay.h"
#include "core/retile/retile.h"
#include "tests/data/ply.h"
#include "tests/data/shapes.h"
#include "tests/data/surface.h"

/* The map onto the finer level is a bijection everywhere: proved anew, in integers. */
static void check_step(const char *name, uint32_t k, const struct lod_retile_level *level, struct lod_arena *arena) {
  struct lod_overlay overlay;
  struct lod_overlay_facts facts;
  assert_int_equal(lod_overlay_create(&level->mesh, &level[1].mesh, level->parents, NULL, arena, &overlay, NULL), LOD_OK);
  if (overlay.failed != 0)
    fail_msg("%s, level %u: %u of %u triangles are not mapped", name, k, overlay.failed, level->mesh.triangle_count);
  assert_int_equal(lod_overlay_check(&overlay, &level->mesh, &level[1].mesh, level->parents, arena, &facts), LOD_OK);
  if (!facts.valid)
    fail_msg("%s, level %u: %s", name, k, facts.reason);
}

/* Re-tiles and checks. */
static void check(const char *name, const struct lod_mesh *mesh, const struct lod_retile_settings *settings, struct lod_arena *arena) {
  struct lod_retile result;
  struct lod_topology source = lod_surface_topology(mesh, arena);
  assert_int_equal(lod_retile_create(mesh, settings, NULL, arena, &result, NULL), LOD_OK);
  for (uint32_t k = 0; k < result.level_count; k++) {
    const struct lod_retile_level *level = &result.levels[k];
    struct lod_topology topology = lod_surface_topology(&level->mesh, arena);
    bool kept = lod_surface_same(&topology, &source) && topology.misoriented_edges <= source.misoriented_edges;
    if (!kept)
      fail_msg("%s, level %u: misoriented edges %u, were %u; euler %lld, was %lld; components %u, were %u; loops %u, were %u; non-manifold "
               "edges %u, were %u",
               name, k, topology.misoriented_edges, source.misoriented_edges, (long long)topology.euler, (long long)source.euler,
               topology.components, source.components, topology.boundary_loops, source.boundary_loops, topology.non_manifold_edges,
               source.non_manifold_edges);
    assert_true(lod_mesh_check(&level->mesh, NULL));
    assert_int_equal(level->candidates + level->retained, level->mesh.vertex_count);
    struct lod_retile_map_facts facts;
    if (k + 1 == result.level_count)
      continue;
    assert_int_equal(lod_retile_check_map(level, level + 1, arena, &facts), LOD_OK);
    assert_true(facts.valid);
    if (facts.folded > level[1].mesh.triangle_count / 500)
      fail_msg("%s, level %u: %u of %u triangles fold", name, k, facts.folded, level[1].mesh.triangle_count);
    check_step(name, k, level, arena);
  }
}

/* A bumpy sheet with random triangles taken out, some turned over or doubled, and fins put on edges. */
static struct lod_mesh damaged_sheet(struct lod_arena *arena, uint64_t *seed) {
  struct lod_mesh sheet = lod_shape_grid(arena, 2, 12, 0.8), mesh = {.vertex_count = sheet.vertex_count};
  mesh.positions = lod_arena_alloc(arena, sheet.vertex_count + 20, sizeof *mesh.positions);
  mesh.triangles = lod_arena_alloc(arena, 2 * (size_t)sheet.triangle_count + 20, sizeof *mesh.triangles);
  memcpy(mesh.positions, sheet.positions, sheet.vertex_count * sizeof *mesh.positions);
  for (uint32_t t = 0; t < sheet.triangle_count; t++) {
    uint32_t *out = mesh.triangles[mesh.triangle_count];
    double dice = lod_random_unit(seed);
    memcpy(out, sheet.triangles[t], sizeof *mesh.triangles);
    if (dice < 0.08)
      continue;
    mesh.triangle_count++;
    if (dice < 0.1) {
      out[1] = sheet.triangles[t][2];
      out[2] = sheet.triangles[t][1];
    } else if (dice < 0.13) {
      float *tip = mesh.positions[mesh.vertex_count];
      if (mesh.vertex_count == sheet.vertex_count + 20)
        continue;
      memcpy(tip, mesh.positions[out[0]], sizeof *mesh.positions);
      tip[2] += 0.5f;
      uint32_t *fin = mesh.triangles[mesh.triangle_count++];
      fin[0] = out[0];
      fin[1] = out[1];
      fin[2] = mesh.vertex_count++;
    }
  }
  return mesh;
}

static void damaged_sheets_keep_their_topology(void **state) {
  (void)state;
  for (uint64_t seed = 1; seed <= 40; seed++) {
    struct lod_arena *arena = lod_arena_create(0);
    uint64_t random = seed;
    struct lod_mesh mesh = damaged_sheet(arena, &random);
    const uint32_t counts[] = {10, 100, 600};
    struct lod_retile_settings settings = lod_retile_defaults();
    char name[32];
    snprintf(name, sizeof name, "sheet %u", (unsigned)seed);
    settings.vertices = counts;
    settings.level_count = 3;
    settings.curvature = (enum lod_retile_curvature)(seed % 3);
    settings.placement = seed % 4 == 0 ? LOD_RETILE_TURK : LOD_RETILE_ELIMINATION;
    check(name, &mesh, &settings, arena);
    lod_arena_destroy(arena);
  }
}

static void trees_and_soups_keep_their_topology(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh tree = lod_shape_tree(arena, 4, true), soup = lod_shape_soup(arena, 300, 0.2, 5);
  const uint32_t counts[] = {100, 2000};
  struct lod_retile_settings settings = lod_retile_defaults();
  settings.vertices = counts;
  settings.level_count = 2;
  check("tree", &tree, &settings, arena);
  check("soup", &soup, &settings, arena);
  lod_arena_destroy(arena);
}

static void shared_models_keep_their_topology(void **state) {
  (void)state;
  static const char *const kModels[] = {"cad/block.ply",    "cad/chair-model.ply", "cad/cessna.ply",          "scans/cow.ply",
                                        "scans/teapot.ply", "thin/dead-tree.ply",  "thin/bones-foot-cgal.ply"};
  const char *shared = lod_shared_folder();
  for (size_t i = 0; shared != NULL && i < sizeof kModels / sizeof *kModels; i++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_mesh raw, mesh;
    char path[4096];
    snprintf(path, sizeof path, "%s/models/%s", shared, kModels[i]);
    const uint32_t counts[] = {100, 1500};
    struct lod_retile_settings settings = lod_retile_defaults();
    settings.vertices = counts;
    settings.level_count = 2;
    if (lod_ply_read(path, arena, &raw)) {
      assert_int_equal(lod_mesh_weld(&raw, arena, &mesh, NULL), LOD_OK);
      check(kModels[i], &mesh, &settings, arena);
    }
    lod_arena_destroy(arena);
  }
}

/* ---- the table: every shared model, each in a process of its own that may take so many seconds of the processor ---- */

struct row {
  uint32_t units, triangles, vertices[3], retained, lost, unmapped; /* vertices, retained (of the coarsest): of all units */
};

static void walk_unit(const struct lod_mesh *mesh, struct lod_arena *arena, struct row *row) {
  const uint32_t counts[] = {50, 400, 3000};
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile result;
  struct lod_topology source = lod_surface_topology(mesh, arena);
  settings.vertices = counts;
  settings.level_count = 3;
  assert_int_equal(lod_retile_create(mesh, &settings, NULL, arena, &result, NULL), LOD_OK);
  bool kept = true;
  for (uint32_t k = 0; k < result.level_count; k++) {
    const struct lod_retile_level *level = &result.levels[k];
    struct lod_topology topology = lod_surface_topology(&level->mesh, arena);
    kept = kept && lod_surface_same(&topology, &source) && topology.misoriented_edges <= source.misoriented_edges &&
           lod_mesh_check(&level->mesh, NULL);
    row->vertices[k] += level->mesh.vertex_count;
    if (k + 1 < result.level_count) {
      struct lod_overlay overlay;
      assert_int_equal(lod_overlay_create(&level->mesh, &level[1].mesh, level->parents, NULL, arena, &overlay, NULL), LOD_OK);
      row->unmapped += overlay.failed;
    }
  }
  row->units++;
  row->triangles += mesh->triangle_count;
  row->retained += result.levels[2].retained;
  row->lost += !kept;
}

static bool walk_model(const char *folder, const char *name, int folder_fd, struct row *row) {
  struct lod_arena *arena = lod_arena_create(0);
  char path[4096];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  FILE *file = fopen(path, "rb");
  long size = file != NULL && fseek(file, 0, SEEK_END) == 0 ? ftell(file) : 0;
  uint8_t *bytes = lod_arena_alloc(arena, (size_t)size + 1, 1);
  if (file != NULL) {
    rewind(file);
    size = (long)fread(bytes, 1, (size_t)size, file);
    fclose(file);
  }
  struct lod_import_limits limits = lod_import_limits_defaults();
  struct lod_import_files files = lod_import_files_beneath(&folder_fd);
  struct lod_import_request request = {.name = name, .bytes = bytes, .size = (size_t)size, .files = &files, .limits = &limits};
  struct lod_model model;
  struct lod_problem problem = {0};
  bool read = size > 0 && lod_import_model(&request, arena, &model, &problem) == LOD_OK;
  for (uint32_t u = 0; read && u < model.unit_count; u++) {
    struct lod_arena *own = lod_arena_create(0);
    walk_unit(&model.units[u].mesh, own, row);
    lod_arena_destroy(own);
  }
  lod_arena_destroy(arena);
  return read;
}

static uint32_t walked, broken;

/* A row. What crashes, loses topology or does not end is told and does not stop the others. */
static void walk_apart(const char *folder, const char *name, int folder_fd, unsigned seconds) {
  fflush(stdout);
  pid_t child = fork();
  if (child == 0) {
    struct row row = {0};
    setrlimit(RLIMIT_CPU, &(struct rlimit){seconds, seconds + 1});
    if (!walk_model(folder, name, folder_fd, &row)) {
      printf("%-40s is not read: no model by itself\n", name);
    } else {
      struct rusage used;
      getrusage(RUSAGE_SELF, &used);
      printf("%-40s %5u %8u | %6u %6u %7u %6u | %s %8u | %7.1f\n", name, row.units, row.triangles, row.vertices[0], row.vertices[1],
             row.vertices[2], row.retained, row.lost == 0 ? "kept" : "LOST", row.unmapped,
             (double)used.ru_utime.tv_sec + 1e-6 * (double)used.ru_utime.tv_usec);
    }
    fflush(stdout);
    _exit(row.lost == 0 ? 0 : 1);
  }
  int status = -1;
  assert_true(child > 0 && waitpid(child, &status, 0) == child);
  walked++;
  bool late = WIFSIGNALED(status) && (WTERMSIG(status) == SIGXCPU || WTERMSIG(status) == SIGKILL);
  if (late)
    printf("%-40s does not end within %u s of the processor\n", name, seconds);
  else if (!WIFEXITED(status) || WEXITSTATUS(status) != 0)
    broken++;
  if (WIFSIGNALED(status) && !late)
    printf("%-40s CRASHES: signal %d\n", name, WTERMSIG(status));
}

static void walk_folder(const char *folder, unsigned seconds) {
  int fd = open(folder, O_RDONLY | O_DIRECTORY);
  struct dirent **entries = NULL;
  int count = fd < 0 ? 0 : scandir(folder, &entries, NULL, alphasort);
  for (int i = 0; i < count; i++) {
    const char *name = entries[i]->d_name, *dot = strrchr(name, '.');
    char inner[4096];
    snprintf(inner, sizeof inner, "%s/%s", folder, name);
    if (dot != NULL && (strcmp(dot, ".ply") == 0 || strcmp(dot, ".glb") == 0 || strcmp(dot, ".gltf") == 0 || strcmp(dot, ".drc") == 0))
      walk_apart(folder, name, fd, seconds);
    else if (entries[i]->d_type == DT_DIR && name[0] != '.')
      walk_folder(inner, seconds);
    free(entries[i]);
  }
  free(entries);
  if (fd >= 0)
    close(fd);
}

/* LODESTREAM_TEST_TABLE=120: the seconds that a model may take; minutes altogether. What came of it: core/retile/MODELS.md. */
static void every_shared_model_keeps_its_topology(void **state) {
  (void)state;
  const char *shared = lod_shared_folder(), *seconds = getenv("LODESTREAM_TEST_TABLE");
  if (shared == NULL || seconds == NULL)
    skip();
  static const char *const kFolders[] = {"scans", "cad", "iso", "thin", "gltf"};
  printf("%-40s %5s %8s | %6s %6s %7s %6s | %s %8s | %7s\n", "model", "units", "tri", "50", "400", "3000", "old", "topo", "unmapped", "s");
  for (size_t i = 0; i < sizeof kFolders / sizeof *kFolders; i++) {
    char folder[2048];
    snprintf(folder, sizeof folder, "%s/models/%s", shared, kFolders[i]);
    walk_folder(folder, (unsigned)strtoul(seconds, NULL, 10));
  }
  printf("%u models walked, %u crash or lose topology\n", walked, broken);
  assert_int_equal(broken, 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(damaged_sheets_keep_their_topology),
      cmocka_unit_test(trees_and_soups_keep_their_topology),
      cmocka_unit_test(shared_models_keep_their_topology),
      cmocka_unit_test(every_shared_model_keeps_its_topology),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
