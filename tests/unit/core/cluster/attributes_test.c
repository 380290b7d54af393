/* Wedges, charts, materials, normals and thick edges of levels. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/cluster/cluster.h"
#include "tests/data/shapes.h"

static struct lod_level level_of(struct lod_arena *arena, const struct lod_mesh *mesh, const struct lod_cluster_settings *settings,
                                 double cell) {
  struct lod_unit *unit = LOD_NEW(arena, 1, struct lod_unit);
  *unit = (struct lod_unit){.mesh = *mesh, .scale = 1};
  struct lod_cluster *cluster;
  struct lod_level level;
  struct lod_problem problem = {0};
  assert_true(lod_mesh_check(mesh, &problem));
  assert_int_equal(lod_cluster_create(unit, 1, settings, NULL, arena, &cluster, &problem), LOD_OK);
  assert_int_equal(lod_cluster_level(cluster, cell, arena, &level, &problem), LOD_OK);
  assert_true(lod_mesh_check(&level.meshes[0], &problem));
  return level;
}

/* A square sheet of two charts: left of x = 0 u = x + 10, right of it u = x - 10; v = y. Vertices on x = 0 have a wedge on each. */
enum { CELLS = 40 };
static struct lod_mesh make_two_charts(struct lod_arena *arena) {
  struct lod_mesh mesh = lod_shape_grid(arena, 2, CELLS, 0);
  uint32_t count = 0, *wedge = LOD_NEW(arena, 2 * (size_t)mesh.vertex_count, uint32_t);
  mesh.wedge_vertex = LOD_NEW(arena, 2 * (size_t)mesh.vertex_count, uint32_t);
  mesh.uvs[0] = lod_arena_alloc(arena, 2 * (size_t)mesh.vertex_count, sizeof *mesh.uvs[0]);
  mesh.corners = lod_arena_alloc(arena, mesh.triangle_count, sizeof *mesh.corners);
  memset(wedge, 0xff, 2 * (size_t)mesh.vertex_count * sizeof *wedge);
  for (uint32_t t = 0; t < mesh.triangle_count; t++) {
    double middle = 0;
    for (int k = 0; k < 3; k++)
      middle += (double)mesh.positions[mesh.triangles[t][k]][0];
    uint32_t side = middle > 0;
    for (int k = 0; k < 3; k++) {
      uint32_t v = mesh.triangles[t][k], *w = &wedge[2 * v + side];
      if (*w == LOD_NONE) {
        *w = count++;
        mesh.wedge_vertex[*w] = v;
        mesh.uvs[0][*w][0] = mesh.positions[v][0] + (side ? -10.0f : 10.0f);
        mesh.uvs[0][*w][1] = mesh.positions[v][1];
      }
      mesh.corners[t][k] = *w;
    }
  }
  mesh.wedge_count = count;
  mesh.normals = NULL;
  mesh.colors = NULL;
  return mesh;
}

static void a_seam_keeps_both_sides_and_no_triangle_spans_two_charts(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = make_two_charts(arena);
  struct lod_cluster_settings settings = lod_cluster_defaults();
  settings.representative = LOD_CLUSTER_CENTRE;
  for (double cell = 0.15; cell < 0.9; cell *= 1.7) {
    struct lod_level level = level_of(arena, &mesh, &settings, cell);
    const struct lod_mesh *m = &level.meshes[0];
    uint32_t seam = 0;
    assert_true(m->triangle_count > 2 && m->triangle_count < mesh.triangle_count);
    for (uint32_t t = 0; t < m->triangle_count; t++) {
      bool left = m->uvs[0][m->corners[t][0]][0] > 0;
      for (int k = 0; k < 3; k++) {
        uint32_t w = m->corners[t][k], v = m->triangles[t][k];
        assert_true((m->uvs[0][w][0] > 0) == left);
        /* The texture has not moved at all: the UV is the centre's own on that chart. */
        assert_true(m->uvs[0][w][0] == m->positions[v][0] + (left ? 10.0f : -10.0f));
        assert_true(m->uvs[0][w][1] == m->positions[v][1]);
        assert_true(left ? m->positions[v][0] <= 0 : m->positions[v][0] >= 0);
      }
    }
    for (uint32_t v = 0; v < m->vertex_count; v++)
      seam += m->positions[v][0] == 0;
    assert_true(seam >= 2); /* seam vertices stand for seam vertices */
    for (uint32_t v = 0; v < mesh.vertex_count; v++)
      if (mesh.positions[v][0] == 0)
        assert_true(m->positions[level.images[0][v]][0] == 0);
  }
  lod_arena_destroy(arena);
}

static void a_chart_too_small_to_be_seen_is_merged_without_jumping_across_the_atlas(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = make_two_charts(arena);
  struct lod_cluster_settings settings = lod_cluster_defaults();
  settings.separate = 100;
  struct lod_level mixed = level_of(arena, &mesh, &settings, 0.3);
  settings.separate = 0;
  struct lod_level apart = level_of(arena, &mesh, &settings, 0.3);
  assert_true(mixed.meshes[0].vertex_count < apart.meshes[0].vertex_count);
  const struct lod_mesh *m = &mixed.meshes[0];
  for (uint32_t t = 0; t < m->triangle_count; t++)
    for (int k = 1; k < 3; k++)
      assert_true((m->uvs[0][m->corners[t][k]][0] > 0) == (m->uvs[0][m->corners[t][0]][0] > 0));
  lod_arena_destroy(arena);
}

static void materials_and_parts_are_those_of_the_source_and_do_not_mix(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_sphere(arena, 1, 4);
  mesh.materials = LOD_NEW(arena, mesh.triangle_count, uint32_t);
  mesh.parts = LOD_NEW(arena, mesh.triangle_count, uint32_t);
  for (uint32_t t = 0; t < mesh.triangle_count; t++) {
    double z = 0;
    for (int k = 0; k < 3; k++)
      z += (double)mesh.positions[mesh.triangles[t][k]][2];
    mesh.materials[t] = z > 0 ? 4 : LOD_NONE;
    mesh.parts[t] = z > 0 ? 1 : 2;
  }
  struct lod_level level = level_of(arena, &mesh, NULL, 0.4);
  const struct lod_mesh *m = &level.meshes[0];
  uint32_t seen[2] = {0, 0};
  for (uint32_t t = 0; t < m->triangle_count; t++) {
    bool upper = m->materials[t] == 4;
    assert_true(upper || m->materials[t] == LOD_NONE);
    assert_int_equal(m->parts[t], upper ? 1 : 2);
    seen[upper]++;
    for (int k = 0; k < 3; k++)
      assert_true(upper ? (double)m->positions[m->triangles[t][k]][2] > -0.25 : (double)m->positions[m->triangles[t][k]][2] < 0.25);
  }
  assert_true(seen[0] > 20 && seen[1] > 20);
  lod_arena_destroy(arena);
}

static struct lod_vec3 face_normal(const struct lod_mesh *mesh, uint32_t t) {
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
  return lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
}

/* smooth: one wedge a vertex, else three a triangle with the triangle's normal. */
static void add_normals(struct lod_arena *arena, struct lod_mesh *mesh, bool smooth) {
  mesh->wedge_count = smooth ? mesh->vertex_count : 3 * mesh->triangle_count;
  mesh->wedge_vertex = LOD_NEW(arena, mesh->wedge_count, uint32_t);
  mesh->normals = lod_arena_alloc(arena, mesh->wedge_count, sizeof *mesh->normals);
  mesh->corners = lod_arena_alloc(arena, mesh->triangle_count, sizeof *mesh->corners);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t v = mesh->triangles[t][k], w = smooth ? v : 3 * t + k;
      mesh->corners[t][k] = w;
      mesh->wedge_vertex[w] = v;
      struct lod_vec3 n = smooth ? lod_vec3_normalize(lod_vec3_from_float(mesh->positions[v])) : face_normal(mesh, t);
      lod_vec3_to_float(n, mesh->normals[w]);
    }
}

static void a_smooth_sphere_stays_smooth_and_a_faceted_one_faceted(void **state) {
  (void)state;
  for (int smooth = 0; smooth < 2; smooth++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_mesh mesh = lod_shape_sphere(arena, 1, 4);
    add_normals(arena, &mesh, smooth != 0);
    struct lod_level level = level_of(arena, &mesh, NULL, 0.3);
    const struct lod_mesh *m = &level.meshes[0];
    assert_true(m->triangle_count > 50);
    if (smooth)
      assert_int_equal(m->wedge_count, m->vertex_count);
    for (uint32_t t = 0; t < m->triangle_count; t++)
      for (int k = 0; k < 3; k++) {
        struct lod_vec3 n = lod_vec3_from_float(m->normals[m->corners[t][k]]);
        assert_true(fabs(lod_vec3_length(n) - 1) < 1e-5);
        if (smooth) /* radial, as the source's */
          assert_true(lod_vec3_dot(n, lod_vec3_normalize(lod_vec3_from_float(m->positions[m->triangles[t][k]]))) > 0.95);
        else
          assert_true(lod_vec3_dot(n, face_normal(m, t)) > 0.99999);
      }
    lod_arena_destroy(arena);
  }
}

/* Wedges that only a triangle without area uses belong to no plane and no part. */
static void wedges_of_flat_triangles_alone_change_nothing(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_sphere(arena, 1, 3), more;
  add_normals(arena, &mesh, false);
  const uint32_t extra = 400, t0 = mesh.triangle_count, w0 = mesh.wedge_count;
  more = mesh;
  more.triangles = lod_arena_alloc(arena, t0 + extra, sizeof *more.triangles);
  more.corners = lod_arena_alloc(arena, t0 + extra, sizeof *more.corners);
  more.normals = lod_arena_alloc(arena, w0 + 3 * (size_t)extra, sizeof *more.normals);
  more.wedge_vertex = LOD_NEW(arena, w0 + 3 * (size_t)extra, uint32_t);
  memcpy(more.triangles, mesh.triangles, t0 * sizeof *more.triangles);
  memcpy(more.corners, mesh.corners, t0 * sizeof *more.corners);
  memcpy(more.normals, mesh.normals, w0 * sizeof *more.normals);
  memcpy(more.wedge_vertex, mesh.wedge_vertex, w0 * sizeof *more.wedge_vertex);
  for (uint32_t i = 0; i < extra; i++) {
    const uint32_t *v = mesh.triangles[i % t0], flat[3] = {v[0], v[1], v[1]};
    memcpy(more.triangles[t0 + i], flat, sizeof flat);
    for (uint32_t k = 0; k < 3; k++) {
      uint32_t w = w0 + 3 * i + k;
      more.corners[t0 + i][k] = w;
      more.wedge_vertex[w] = flat[k];
      memcpy(more.normals[w], (float[3]){0, 0, 1}, sizeof more.normals[w]);
    }
  }
  more.triangle_count += extra;
  more.wedge_count += 3 * extra;
  struct lod_level plain = level_of(arena, &mesh, NULL, 0.3), with = level_of(arena, &more, NULL, 0.3);
  assert_int_equal(with.meshes[0].triangle_count, plain.meshes[0].triangle_count);
  assert_int_equal(with.meshes[0].vertex_count, plain.meshes[0].vertex_count);
  for (uint32_t t = 0; t < with.meshes[0].triangle_count; t++)
    for (int k = 0; k < 3; k++) /* still faceted */
      assert_true(lod_vec3_dot(lod_vec3_from_float(with.meshes[0].normals[with.meshes[0].corners[t][k]]), face_normal(&with.meshes[0], t)) >
                  0.99999);
  lod_arena_destroy(arena);
}

/* A roof of two smooth slopes with a hard ridge: wedges on the ridge differ, each slope is shaded by itself. */
static void a_ridge_stays_sharp(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = make_two_charts(arena);
  for (uint32_t v = 0; v < mesh.vertex_count; v++)
    mesh.positions[v][2] = -fabsf(mesh.positions[v][0]) - 0.15f * mesh.positions[v][0] * mesh.positions[v][0];
  mesh.uvs[0] = NULL; /* the wedges stay: they now tell normals apart */
  mesh.normals = lod_arena_calloc(arena, mesh.wedge_count, sizeof *mesh.normals);
  for (uint32_t t = 0; t < mesh.triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      double x = (double)mesh.positions[mesh.triangles[t][k]][0];
      double middle = 0;
      for (int c = 0; c < 3; c++)
        middle += (double)mesh.positions[mesh.triangles[t][c]][0];
      double slope = (middle > 0 ? -1 : 1) - 0.3 * x;
      lod_vec3_to_float(lod_vec3_normalize(lod_vec3_make(-slope, 0, 1)), mesh.normals[mesh.corners[t][k]]);
    }
  struct lod_cluster_settings settings = lod_cluster_defaults();
  settings.representative = LOD_CLUSTER_CENTRE;
  struct lod_level level = level_of(arena, &mesh, &settings, 0.3);
  const struct lod_mesh *m = &level.meshes[0];
  uint32_t ridge = 0;
  for (uint32_t t = 0; t < m->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      if (m->positions[m->triangles[t][k]][0] != 0)
        continue;
      struct lod_vec3 n = lod_vec3_from_float(m->normals[m->corners[t][k]]), f = face_normal(m, t);
      if (fabs(f.x) < 0.5) /* a triangle across the ridge, from a cell that holds vertices of both slopes */
        continue;
      assert_true(fabs(n.x) > 0.3 && n.x * f.x > 0);
      ridge++;
    }
  assert_true(ridge >= 4);
  lod_arena_destroy(arena);
}

/* Colours come from one source corner each: with two colours alone in the source, no third appears. */
static void colours_are_never_averaged(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_torus(arena, 3, 1, 60, 30);
  add_normals(arena, &mesh, true);
  mesh.normals = NULL;
  mesh.colors = lod_arena_calloc(arena, mesh.wedge_count, sizeof *mesh.colors);
  for (uint32_t w = 0; w < mesh.wedge_count; w++) {
    mesh.colors[w][w % 3 == 0 ? 0 : 1] = 1;
    mesh.colors[w][3] = 1;
  }
  struct lod_level level = level_of(arena, &mesh, NULL, 0.5);
  const struct lod_mesh *m = &level.meshes[0];
  assert_true(m->wedge_count > 20);
  for (uint32_t w = 0; w < m->wedge_count; w++)
    assert_true((m->colors[w][0] == 1) != (m->colors[w][1] == 1));
  lod_arena_destroy(arena);
}

/* A long tube of radius r in cells much wider than r: edges in a row, each as thick as the tube's rings are wide. */
static void a_tube_becomes_edges_as_thick_as_the_tube(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  const double kRadius = 0.05;
  struct lod_mesh mesh = lod_shape_tube(arena, kRadius, 20, 16, 200);
  struct lod_level level = level_of(arena, &mesh, NULL, 1);
  const struct lod_mesh *m = &level.meshes[0];
  assert_int_equal(m->triangle_count, 0);
  assert_int_equal(m->point_count, 0);
  assert_int_equal(m->edge_count, m->vertex_count - 1);
  for (uint32_t e = 0; e < m->edge_count; e++) /* D_A = D_B = r: thickness 2 r, the diameter; less where the caps' middles count */
    assert_true(fabs((double)m->edge_thickness[e] - 2 * kRadius) < 0.15 * kRadius);
  lod_arena_destroy(arena);
}

/* The formula of 3.3.1 by hand: V_A = {a1, a2}, V_B = {b1, b2}. */
static void thickness_is_the_sum_of_the_mean_distances_to_the_line_of_means(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = {.vertex_count = 5, .triangle_count = 3};
  mesh.positions = lod_arena_copy(arena, (float[5][3]){{0, 0.1f, 0}, {0, -0.1f, 0}, {5, 0.3f, 0}, {5, -0.3f, 0}, {0.05f, 0.1f, 0.4f}}, 60);
  /* The last triangle lies in A alone: it must not count, though its third vertex belongs to A. */
  mesh.triangles = lod_arena_copy(arena, (uint32_t[3][3]){{0, 1, 2}, {1, 3, 2}, {0, 4, 1}}, 36);
  struct lod_level level = level_of(arena, &mesh, NULL, 2);
  assert_int_equal(level.meshes[0].edge_count, 1);
  assert_int_equal(level.meshes[0].point_count, 0);
  assert_true(fabs((double)level.meshes[0].edge_thickness[0] - (0.1 + 0.3)) < 1e-6);
  lod_arena_destroy(arena);
}

/* Thousands of charts of one triangle each: no chart can be kept apart at coarse levels, and nothing gets slow or large. */
static void a_chart_for_every_triangle_still_simplifies(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh mesh = lod_shape_sphere(arena, 1, 5);
  add_normals(arena, &mesh, false);
  mesh.normals = NULL;
  mesh.uvs[0] = lod_arena_alloc(arena, mesh.wedge_count, sizeof *mesh.uvs[0]);
  for (uint32_t w = 0; w < mesh.wedge_count; w++) {
    mesh.uvs[0][w][0] = (float)(w / 3);
    mesh.uvs[0][w][1] = (float)(w % 3);
  }
  struct lod_level level = level_of(arena, &mesh, NULL, 0.4);
  assert_true(level.meshes[0].triangle_count > 50 && level.meshes[0].triangle_count < mesh.triangle_count / 20);
  for (uint32_t t = 0; t < level.meshes[0].triangle_count; t++) /* every level triangle shows texture of one source triangle */
    for (int k = 1; k < 3; k++)
      assert_true(level.meshes[0].uvs[0][level.meshes[0].corners[t][k]][0] == level.meshes[0].uvs[0][level.meshes[0].corners[t][0]][0]);
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_seam_keeps_both_sides_and_no_triangle_spans_two_charts),
      cmocka_unit_test(a_chart_too_small_to_be_seen_is_merged_without_jumping_across_the_atlas),
      cmocka_unit_test(materials_and_parts_are_those_of_the_source_and_do_not_mix),
      cmocka_unit_test(a_smooth_sphere_stays_smooth_and_a_faceted_one_faceted),
      cmocka_unit_test(wedges_of_flat_triangles_alone_change_nothing),
      cmocka_unit_test(a_ridge_stays_sharp),
      cmocka_unit_test(colours_are_never_averaged),
      cmocka_unit_test(a_tube_becomes_edges_as_thick_as_the_tube),
      cmocka_unit_test(thickness_is_the_sum_of_the_mean_distances_to_the_line_of_means),
      cmocka_unit_test(a_chart_for_every_triangle_still_simplifies),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
