/* Attributes of envelope levels: every point of the source has a point of the level on its own patch within epsilon whose UV and normal
 * differ by no more than the bounds, against a search of its own; and what becomes of seams where they meet. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#include "core/envelope/envelope.h"
#include "core/mesh/distance.h"
#include "core/mesh/topology.h"
#include "core/mesh/triangle_distance.h"
#include "tests/data/shapes.h"

enum { PATCHES = 9, SAMPLES = 1500 };

/* A wavy square in patches of one material each, whose UV jump where they meet. */
static struct lod_mesh quilt(struct lod_arena *arena, int cells, double bump, uint64_t seed) {
  struct lod_mesh mesh = lod_shape_grid(arena, 1, cells, bump);
  double seeds[PATCHES][2];
  for (int i = 0; i < PATCHES; i++)
    for (int k = 0; k < 2; k++)
      seeds[i][k] = lod_random_unit(&seed) - 0.5;
  mesh.materials = LOD_NEW(arena, mesh.triangle_count, uint32_t);
  uint32_t most = PATCHES * mesh.vertex_count, *wedge_of = LOD_NEW(arena, most, uint32_t);
  float(*uvs)[2] = lod_arena_alloc(arena, most, sizeof *uvs), (*normals)[3] = lod_arena_alloc(arena, most, sizeof *normals);
  mesh.corners = lod_arena_alloc(arena, mesh.triangle_count, sizeof *mesh.corners);
  mesh.wedge_vertex = LOD_NEW(arena, most, uint32_t);
  memset(wedge_of, 0xff, most * sizeof *wedge_of);
  mesh.wedge_count = 0;
  for (uint32_t t = 0; t < mesh.triangle_count; t++) {
    double x = 0, y = 0, best = INFINITY;
    for (int k = 0; k < 3; k++) {
      x += (double)mesh.positions[mesh.triangles[t][k]][0] / 3;
      y += (double)mesh.positions[mesh.triangles[t][k]][1] / 3;
    }
    for (uint32_t i = 0; i < PATCHES; i++)
      if (hypot(x - seeds[i][0], y - seeds[i][1]) < best) {
        best = hypot(x - seeds[i][0], y - seeds[i][1]);
        mesh.materials[t] = i;
      }
    for (int k = 0; k < 3; k++) {
      uint32_t v = mesh.triangles[t][k], *wedge = &wedge_of[PATCHES * v + mesh.materials[t]];
      const float *p = mesh.positions[v];
      if (*wedge == LOD_NONE) {
        *wedge = mesh.wedge_count++;
        mesh.wedge_vertex[*wedge] = v;
        uvs[*wedge][0] = (float)((double)p[0] + 0.3 * sin(3 * (double)p[1]) + 2 * mesh.materials[t]);
        uvs[*wedge][1] = (float)((double)p[1] + (double)p[2]);
        struct lod_vec3 n = lod_vec3_normalize(lod_vec3_make(-(double)p[2] * 4, (double)p[2] * 3, 1));
        lod_vec3_to_float(n, normals[*wedge]);
      }
      mesh.corners[t][k] = *wedge;
    }
  }
  mesh.uvs[0] = uvs;
  mesh.normals = normals;
  return mesh;
}

struct point {
  struct lod_vec3 at, normal;
  double uv[2];
};

static struct point point_of(const struct lod_mesh *mesh, uint32_t t, double b, double c) {
  const double w[3] = {1 - b - c, b, c};
  struct point p = {{0, 0, 0}, {0, 0, 0}, {0, 0}};
  for (int k = 0; k < 3; k++) {
    p.at = lod_vec3_add_scaled(p.at, lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]), w[k]);
    p.normal = lod_vec3_add_scaled(p.normal, lod_vec3_from_float(mesh->normals[mesh->corners[t][k]]), w[k]);
    for (int i = 0; i < 2; i++)
      p.uv[i] += w[k] * (double)mesh->uvs[0][mesh->corners[t][k]][i];
  }
  return p;
}

struct bounds {
  double epsilon, uv, normal; /* the last a chord */
};

/* The largest of the differences over their bounds: convex over a triangle. */
static double misfit(const struct point *p, const struct point *q, const struct bounds *bounds) {
  double worst = lod_vec3_distance(p->at, q->at) / bounds->epsilon;
  worst = fmax(worst, hypot(p->uv[0] - q->uv[0], p->uv[1] - q->uv[1]) / bounds->uv);
  return fmax(worst, lod_vec3_distance(p->normal, q->normal) / bounds->normal);
}

static double along(const struct lod_mesh *mesh, uint32_t t, double b, const struct point *p, const struct bounds *bounds) {
  double low = 0, high = 1 - b;
  for (int i = 0; i < 40; i++) {
    double l = low + (high - low) / 3, r = high - (high - low) / 3;
    struct point x = point_of(mesh, t, b, l), y = point_of(mesh, t, b, r);
    if (misfit(p, &x, bounds) < misfit(p, &y, bounds))
      high = r;
    else
      low = l;
  }
  struct point x = point_of(mesh, t, b, (low + high) / 2);
  return misfit(p, &x, bounds);
}

/* The least misfit over the triangles of a material. */
static double best_fit(const struct lod_mesh *mesh, uint32_t material, const struct point *p, const struct bounds *bounds) {
  double best = INFINITY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    const uint32_t *v = mesh->triangles[t];
    if (mesh->materials[t] != material)
      continue;
    struct lod_vec3 near = lod_closest_on_triangle(p->at, lod_vec3_from_float(mesh->positions[v[0]]),
                                                   lod_vec3_from_float(mesh->positions[v[1]]), lod_vec3_from_float(mesh->positions[v[2]]));
    if (lod_vec3_distance(near, p->at) > bounds->epsilon * 1.0001)
      continue;
    double low = 0, high = 1;
    for (int i = 0; i < 40 && best > 1; i++) {
      double l = low + (high - low) / 3, r = high - (high - low) / 3;
      if (along(mesh, t, l, p, bounds) < along(mesh, t, r, p, bounds))
        high = r;
      else
        low = l;
      best = fmin(best, along(mesh, t, (low + high) / 2, p, bounds));
    }
  }
  return best;
}

/* Vertices where three materials or more meet. */
static uint32_t meetings(struct lod_arena *arena, const struct lod_mesh *mesh) {
  uint32_t *met = LOD_NEW_ZERO(arena, mesh->vertex_count, uint32_t), count = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++)
      met[mesh->triangles[t][k]] |= 1u << mesh->materials[t];
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    count += __builtin_popcount(met[v]) > 2;
  return count;
}

struct check {
  struct lod_arena *arena;
  const struct lod_mesh *source;
  struct bounds bounds;
  uint32_t triangles, meetings, broken;
};

static enum lod_status check_level(void *context, const struct lod_level *level) {
  struct check *check = context;
  const struct lod_mesh *mesh = &level->meshes[0];
  assert_true(lod_mesh_check(mesh, NULL));
  struct lod_topology before, after;
  assert_int_equal(lod_topology_measure(check->source, NULL, check->arena, &before), LOD_OK);
  assert_int_equal(lod_topology_measure(mesh, NULL, check->arena, &after), LOD_OK);
  assert_true(after.manifold && after.euler == before.euler && after.boundary_loops == before.boundary_loops);
  struct bounds bounds = check->bounds;
  bounds.epsilon = level->bound;
  uint64_t random = 7;
  check->broken = 0;
  for (int i = 0; i < SAMPLES; i++) {
    uint32_t t = (uint32_t)(lod_random_unit(&random) * check->source->triangle_count);
    double b = lod_random_unit(&random), c = lod_random_unit(&random);
    struct point p = point_of(check->source, t, b + c > 1 ? 1 - b : b, b + c > 1 ? 1 - c : c);
    check->broken += !(best_fit(mesh, check->source->materials[t], &p, &bounds) <= 1.001);
  }
  check->triangles = mesh->triangle_count;
  check->meetings = meetings(check->arena, mesh);
  return LOD_OK;
}

static struct check simplify(struct lod_arena *arena, const struct lod_mesh *mesh, double epsilon, double uv, double degrees,
                             struct lod_envelope_report *report) {
  struct lod_unit unit = {.mesh = *mesh, .scale = 1};
  struct lod_envelope_settings settings = lod_envelope_defaults();
  struct check check = {.arena = arena, .source = mesh, .bounds = {epsilon, 0.008, 2 * sin(6 * 0.5 * 0.017453292519943295)}};
  settings.epsilons = &epsilon;
  settings.epsilon_count = 1;
  settings.least_gain = 0;
  settings.reports = report;
  settings.threads = 1;
  settings.collapse.guarding = LOD_GUARD_ALL;
  settings.collapse.attributes = (struct lod_attribute_bounds){.uv = uv, .normal_degrees = degrees};
  struct lod_problem problem = {0};
  assert_int_equal(lod_envelope_family.build(&unit, 1, &settings, NULL, arena, check_level, &check, &problem), LOD_OK);
  return check;
}

/* The same without bounds breaks them: else this could not fail. */
static void bounds_hold(struct lod_arena *arena) {
  for (uint64_t seed = 1; seed <= 3; seed++) {
    struct lod_mesh mesh = quilt(arena, 24, 0.2, seed);
    struct lod_envelope_report report, free_report;
    struct check bounded = simplify(arena, &mesh, 0.05, 0.008, 6, &report);
    struct check unbounded = simplify(arena, &mesh, 0.05, 0, 0, &free_report);
    assert_int_equal(bounded.broken, 0);
    assert_true(unbounded.broken > SAMPLES / 20);
    assert_true(bounded.triangles < mesh.triangle_count / 2);
    assert_true(fabs(report.uv_bound[0] - 0.008) < 1e-12 && fabs(report.normal_bound - 6) < 1e-12);
    assert_true(isinf(free_report.uv_bound[0]) && free_report.uv[0] > 0.008);
    assert_true(report.uv[0] < 2 * 0.008 && report.normal_degrees < 12);
  }
}

static void test_every_point_finds_its_attributes_within_the_bounds(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  bounds_hold(arena);
  lod_arena_destroy(arena);
}

/* Where attributes are bounded patches are, and corners of lines may merge as long as they stay apart. */
static void test_meeting_points_of_seams_merge_within_the_bounds(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = quilt(arena, 24, 0.05, 5);
  uint32_t before = meetings(arena, &mesh);
  struct lod_envelope_report report;
  struct check loose = simplify(arena, &mesh, 0.15, 0.3, 90, &report);
  struct check fixed = simplify(arena, &mesh, 0.15, 0, 0, &report);
  assert_int_equal(fixed.meetings, before);
  assert_true(loose.meetings > 0 && loose.meetings < before);
  lod_arena_destroy(arena);
}

/* UV that are linear in space, and normals that are the same everywhere, lose nothing: bounds cost no triangles. */
static void test_linear_attributes_cost_nothing(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh grid = lod_shape_grid(arena, 1, 24, 0);
  grid.materials = LOD_NEW_ZERO(arena, grid.triangle_count, uint32_t);
  grid.normals = lod_arena_alloc(arena, grid.wedge_count, sizeof *grid.normals);
  for (uint32_t w = 0; w < grid.wedge_count; w++)
    memcpy(grid.normals[w], (const float[3]){0, 0, 1}, sizeof *grid.normals);
  struct lod_envelope_report report;
  struct check check = simplify(arena, &grid, 0.02, 0.008, 6, &report);
  assert_int_equal(check.broken, 0);
  assert_true(check.triangles <= 4);
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_every_point_finds_its_attributes_within_the_bounds),
      cmocka_unit_test(test_meeting_points_of_seams_merge_within_the_bounds),
      cmocka_unit_test(test_linear_attributes_cost_nothing),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
