/* What must hold for every mesh: the topology stays, levels are nested, maps are valid. Random shapes with holes, bow ties, fins and
 * creases; and the shared models where they are. */
#include <dirent.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/mesh/topology.h"
#include "core/retile/retile.h"
#include "tests/data/ply.h"
#include "tests/data/shapes.h"

static struct lod_topology topology_of(const struct lod_mesh *mesh, struct lod_arena *arena) {
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(mesh, NULL, arena, &topology), LOD_OK);
  return topology;
}

/* Re-tiles and checks. */
static void check(const char *name, const struct lod_mesh *mesh, const struct lod_retile_settings *settings, struct lod_arena *arena) {
  struct lod_retile result;
  struct lod_topology source = topology_of(mesh, arena);
  assert_int_equal(lod_retile_create(mesh, settings, NULL, arena, &result, NULL), LOD_OK);
  for (uint32_t k = 0; k < result.level_count; k++) {
    const struct lod_retile_level *level = &result.levels[k];
    struct lod_topology topology = topology_of(&level->mesh, arena);
    bool kept = topology.euler == source.euler && topology.components == source.components &&
                topology.boundary_loops == source.boundary_loops && topology.non_manifold_edges == source.non_manifold_edges &&
                topology.misoriented_edges == source.misoriented_edges && topology.degenerate_triangles == 0;
    if (!kept)
      fail_msg("%s, level %u: euler %lld, was %lld; components %u, were %u; loops %u, were %u; non-manifold edges %u, were %u", name, k,
               (long long)topology.euler, (long long)source.euler, topology.components, source.components, topology.boundary_loops,
               source.boundary_loops, topology.non_manifold_edges, source.non_manifold_edges);
    assert_true(lod_mesh_check(&level->mesh, NULL));
    assert_int_equal(level->candidates + level->retained, level->mesh.vertex_count);
    struct lod_retile_map_facts facts;
    if (k + 1 == result.level_count)
      continue;
    assert_int_equal(lod_retile_check_map(level, level + 1, arena, &facts), LOD_OK);
    assert_true(facts.valid);
    assert_int_equal(facts.inside + facts.straddling, level[1].mesh.triangle_count);
    if (facts.folded > level[1].mesh.triangle_count / 10)
      fail_msg("%s, level %u: %u of %u triangles fold", name, k, facts.folded, level[1].mesh.triangle_count);
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

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(damaged_sheets_keep_their_topology),
      cmocka_unit_test(trees_and_soups_keep_their_topology),
      cmocka_unit_test(shared_models_keep_their_topology),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
