/* Patch files: curves that one knows, and what is wrong told by line. */
#include <math.h>

#include "core/clod/clod.h"
#include "core/mesh/topology.h"
#include "tests/unit/codec/import/importing.h"

static struct test_import import_text(const char *text, const char *name) {
  return test_import_bytes(text, strlen(text), name);
}

static void expect(const char *text, const char *name, const char *type, const char *words) {
  struct test_import i = import_text(text, name);
  if (i.status == LOD_OK || strcmp(i.problem.type, type) != 0 || strstr(i.problem.detail, words) == NULL)
    fail_msg("expected '%s' with '%s', got '%s': %s", type, words, i.problem.type, i.problem.detail);
  test_import_end(&i);
}

static void a_bilinear_patch_is_two_triangles(void **state) {
  (void)state;
  struct test_import i = import_text("1\n1 1\n0 0 0\n0 1 0\n1 0 0\n1 1 0\n", "square.bpt");
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "bpt");
  assert_int_equal(i.model.units[0].mesh.triangle_count, 2);
  assert_int_equal(i.model.units[0].mesh.vertex_count, 4);
  assert_true(i.model.rounding < 1e-12);
  test_import_end(&i);
}

/* z = x^2 over the unit square, as degrees 2 by 1: known everywhere. */
static void a_parabola_is_met_within_the_rounding_told(void **state) {
  (void)state;
  struct test_import i = import_text("1\n2 1\n0 0 0\n0 1 0\n0.5 0 0\n0.5 1 0\n1 0 1\n1 1 1\n", "parabola.bpt");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  double worst = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    assert_true(fabs((double)mesh->positions[v][2] - (double)mesh->positions[v][0] * (double)mesh->positions[v][0]) < 1e-6);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      const float *a = mesh->positions[mesh->triangles[t][k]], *b = mesh->positions[mesh->triangles[t][(k + 1) % 3]];
      double x = 0.5 * ((double)a[0] + (double)b[0]), z = 0.5 * ((double)a[2] + (double)b[2]);
      worst = fmax(worst, z - x * x);
    }
  assert_true(worst > 0 && worst <= i.model.rounding && i.model.rounding < 1e-3);
  test_import_end(&i);
}

/* A house: four walls, two gables of five corners, one of which is cut into triangles with a corner that comes first, a floor and roofs. */
static void a_polyhedron_of_n_gons_is_read_with_patches(void **state) {
  (void)state;
  static const char kHouse[] = "Group 1 house\n1\n10 7\n0 0 0\n2 0 0\n2 0 1\n1 0 2\n0 0 1\n0 3 0\n2 3 0\n2 3 1\n1 3 2\n0 3 1\n"
                               "5 0 1 2 3 4\n5 9 8 7 6 5\n4 0 5 6 1\n4 1 6 7 2\n4 2 7 8 3\n4 3 8 9 4\n4 4 9 5 0\n";
  struct test_import i = import_text(kHouse, "house.bv");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->triangle_count, 2 * 3 + 5 * 2);
  assert_int_equal(mesh->vertex_count, 10);
  double volume = 0; /* closed, and turned outwards: 2 * 1 * 3 below, 1 * 3 under the roof */
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
    volume += lod_vec3_dot(p[0], lod_vec3_cross(p[1], p[2])) / 6;
  }
  assert_true(fabs(fabs(volume) - 9) < 1e-9);
  test_import_end(&i);
  /* A face that is not convex: an L of area 3. */
  i = import_text("1 6 1  0 0 0  2 0 0  2 1 0  1 1 0  1 2 0  0 2 0  6 0 1 2 3 4 5\n", "l.bv");
  test_expect_ok(&i);
  double area = 0;
  mesh = &i.model.units[0].mesh;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    const uint32_t *c = mesh->triangles[t];
    struct lod_vec3 a = lod_vec3_from_float(mesh->positions[c[0]]);
    struct lod_vec3 n = lod_vec3_cross(lod_vec3_subtract(lod_vec3_from_float(mesh->positions[c[1]]), a),
                                       lod_vec3_subtract(lod_vec3_from_float(mesh->positions[c[2]]), a));
    assert_true(n.z > 0);
    area += n.z / 2;
  }
  assert_true(fabs(area - 3) < 1e-9);
  test_import_end(&i);
  expect("1\n3 1\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "a.bv", "index-out-of-range", "line 6 names vertex 3 of 3");
  expect("1\n3 1\n0 0 0\n1 0 0\n0 1 0\n2 0 1 \n\n\n\n", "a.bv", "bad-syntax", "line 6");
  expect("1\n3 1\n0 0 0\n1 0 0\n0 1 0\n99 0 1 2\n", "a.bv", "truncated", "99 corners");
  expect("1\n4000000000 1\n0 0 0\n", "a.bv", "truncated", "line 2");
  expect("1\n3 1\n0 0 0\n1 inf 0\n0 1 0\n3 0 1 2\n", "a.bv", "non-finite", "line 4");
}

/* The same quarter with the normals that kinds 9 and 10 add is the same surface. */
static void normals_behind_points_are_passed_over(void **state) {
  (void)state;
  struct test_import i = import_text("9\n1 2\n0 0 0\n1 0 0\n0 1 0\n 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1\n"
                                     "10\n1 1 1 2\n1 0 0\n1 1 0\n2 0 0\n2 1 0\n0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1\n",
                                     "pn.bv");
  test_expect_ok(&i);
  assert_int_equal(i.model.units[0].mesh.triangle_count, 3);
  test_import_end(&i);
  expect("9\n1 1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0\n", "a.bv", "truncated", "a normal");
}

/* Many parabolas: at the limit, the rest are not cut. Else their triangles would be in memory before anybody looked. */
static void a_limit_of_vertices_ends_the_cutting(void **state) {
  (void)state;
  enum { PATCHES = 500 };
  static char text[PATCHES * 96 + 16];
  size_t size = (size_t)sprintf(text, "%d\n", PATCHES);
  for (int p = 0; p < PATCHES; p++)
    size += (size_t)sprintf(text + size, "2 1\n0 0 %d\n0 1 %d\n0.5 0 %d\n0.5 1 %d\n1 0 %d\n1 1 %d\n", p, p, p, p, p + 1, p + 1);
  struct lod_import_limits limits = lod_import_limits_defaults();
  struct test_import whole = test_import_with(text, size, "many.bpt", NULL, &limits);
  test_expect_ok(&whole);
  limits.max_vertices = 1000;
  struct test_import part = test_import_with(text, size, "many.bpt", NULL, &limits);
  assert_int_equal(part.status, LOD_LIMIT);
  assert_string_equal(part.problem.type, "limit-vertices");
  assert_true(lod_arena_peak_bytes(part.arena) < lod_arena_peak_bytes(whole.arena) / 2);
  test_import_end(&whole);
  test_import_end(&part);
}

static void a_patch_file_needs_no_ending(void **state) {
  (void)state;
  struct test_import i = import_text("\n1 \r\n1 1\r\n0 0 0\r\n0 1 0\n1 0 0\n1 1 0\n", "upload");
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "bpt");
  test_import_end(&i);
  /* Numbers that are something else. */
  expect("1\n1 1\n0 0 0 0\n", "upload", "unknown-format", "ends in the format");
  expect("1\n10 1\n0 0 0\n", "upload", "unknown-format", "ends in the format");
  expect("1 1\n1 1\n0 0 0\n", "upload", "unknown-format", "ends in the format");
  expect("0.5\n1 1\n0 0 0\n", "upload", "unknown-format", "ends in the format");
  expect("1\n1 1\n0 0 0", "upload", "unknown-format", "ends in the format");
}

static void patches_that_share_an_edge_share_its_vertices(void **state) {
  (void)state;
  /* The second patch sees the curved edge from its other end. */
  struct test_import i = import_text("2\n2 2\n0 0 0\n0 1 0.7\n0 2 0\n1 0 0\n1 1 0.3\n1 2 0\n2 0 0\n2 1 0.9\n2 2 0\n"
                                     "2 2\n0 2 0\n0 1 0.7\n0 0 0\n-1 2 0\n-1 1 0\n-1 0 0\n-2 2 0\n-2 1 0\n-2 0 0\n",
                                     "pair.bpt");
  test_expect_ok(&i);
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(&i.model.units[0].mesh, NULL, i.arena, &topology), LOD_OK);
  assert_int_equal(topology.boundary_loops, 1);
  assert_int_equal(topology.components, 1);
  assert_true(topology.manifold);
  test_import_end(&i);
}

static void a_collapsed_side_leaves_no_flat_triangle(void **state) {
  (void)state;
  struct test_import i = import_text("1\n1 1\n0 0 0\n0 0 0\n1 0 0\n0 1 0\n", "fan.bpt");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  double area = 0;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
    assert_true(lod_vec3_distance(p[0], p[1]) > 0 && lod_vec3_distance(p[1], p[2]) > 0 && lod_vec3_distance(p[2], p[0]) > 0);
    area += 0.5 * lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])).z;
  }
  assert_true(fabs(area - 0.5) < 1e-3);
  test_import_end(&i);
}

static void bezierview_triangles_and_rational_patches_are_read(void **state) {
  (void)state;
  /* A quarter of a cylinder of radius 1: rational quadratic by linear, points already multiplied by their weights. */
  struct test_import i = import_text("8 2 1\n1 0 0 1\n1 0 2 1\n0.70710678118654752 0.70710678118654752 0 0.70710678118654752\n"
                                     "0.70710678118654752 0.70710678118654752 1.41421356237309505 0.70710678118654752\n0 1 0 1\n0 1 2 1\n",
                                     "quarter.bv");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_true(mesh->triangle_count > 8);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    assert_true(fabs(hypot((double)mesh->positions[v][0], (double)mesh->positions[v][1]) - 1) < 1e-6);
  test_import_end(&i);
  i = import_text("Group 1 corner\n3 1\n0 0 0\n1 0 0\n0 1 0\n", "corner.bv");
  test_expect_ok(&i);
  assert_int_equal(i.model.units[0].mesh.triangle_count, 1);
  test_import_end(&i);
}

static void geomview_names_its_degrees(void **state) {
  (void)state;
  struct test_import i = import_text("BEZ113\n0 0 0  1 0 0\n0 1 0  1 1 0\n", "square.bez");
  test_expect_ok(&i);
  assert_int_equal(i.model.units[0].mesh.triangle_count, 2);
  test_import_end(&i);
  expect("BEZ11x\n", "x.bez", "bad-syntax", "line 1");
}

/* A full circle as a quadratic NURBS of nine points swept along z: knot insertion has to find four quarters. */
static void a_nurbs_cylinder_is_round(void **state) {
  (void)state;
  static const char kText[] =
      "##RenderMan RIB-Structure 1.0\nWorldBegin\nNuPatch 9 3 [0 0 0 1 1 2 2 3 3 4 4 4] 0 4  2 2 [0 0 1 1] 0 1 \"Pw\" [\n"
      "1 0 0 1  0.70710678118654752 0.70710678118654752 0 0.70710678118654752  0 1 0 1  -0.70710678118654752 0.70710678118654752 0 "
      "0.70710678118654752  -1 0 0 1  -0.70710678118654752 -0.70710678118654752 0 0.70710678118654752  0 -1 0 1  0.70710678118654752 "
      "-0.70710678118654752 0 0.70710678118654752  1 0 0 1\n"
      "1 0 3 1  0.70710678118654752 0.70710678118654752 2.12132034355964257 0.70710678118654752  0 1 3 1  -0.70710678118654752 "
      "0.70710678118654752 2.12132034355964257 0.70710678118654752  -1 0 3 1  -0.70710678118654752 -0.70710678118654752 "
      "2.12132034355964257 0.70710678118654752  0 -1 3 1  0.70710678118654752 -0.70710678118654752 2.12132034355964257 "
      "0.70710678118654752  1 0 3 1]\nWorldEnd\n";
  struct test_import i = import_text(kText, "cylinder.rib");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    assert_true(fabs(hypot((double)mesh->positions[v][0], (double)mesh->positions[v][1]) - 1) < 1e-6);
  struct lod_topology topology;
  assert_int_equal(lod_topology_measure(mesh, NULL, i.arena, &topology), LOD_OK);
  assert_int_equal(topology.boundary_loops, 2);
  assert_int_equal(topology.euler, 0);
  test_import_end(&i);
}

/* A cubic with a single knot in the middle, inserted twice, against the B-spline at that knot: (1 4 1)/6-like weights. */
static void knots_are_inserted_up_to_bezier(void **state) {
  (void)state;
  struct test_import i = import_text("NuPatch 5 4 [0 0 0 0 1 2 2 2 2] 0 2  2 2 [0 0 1 1] 0 1 \"P\" [0 0 0 1 2 0 2 0 0 3 2 0 4 0 0\n"
                                     "0 0 1 1 2 1 2 0 1 3 2 1 4 0 1]\n",
                                     "cubic.rib");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  bool found = false; /* the curve at knot 1 by de Boor: (2, 1) */
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    found = found || (fabs((double)mesh->positions[v][0] - 2) < 1e-6 && fabs((double)mesh->positions[v][1] - 1) < 1e-6);
  assert_true(found);
  test_import_end(&i);
}

static void rib_transforms_and_bases_apply(void **state) {
  (void)state;
  struct test_import i = import_text("WorldBegin TransformBegin Translate 10 0 0 Scale 2 2 2\n"
                                     "Patch \"bilinear\" \"P\" [0 0 0 1 0 0 0 1 0 1 1 0] TransformEnd\nWorldEnd\n",
                                     "moved.rib");
  test_expect_ok(&i);
  struct lod_bounds bounds = lod_mesh_bounds(&i.model.units[0].mesh);
  assert_true(bounds.min[0] == 10 && bounds.max[0] == 12 && bounds.max[1] == 2);
  test_import_end(&i);
  /* A flat B-spline mesh of 4 by 5 points on a unit grid: two patches over the middle. */
  char text[1024] = "Basis \"b-spline\" 1 \"b-spline\" 1 PatchMesh \"bicubic\" 5 \"nonperiodic\" 4 \"nonperiodic\" \"P\" [";
  for (int v = 0; v < 4; v++)
    for (int u = 0; u < 5; u++)
      snprintf(text + strlen(text), sizeof text - strlen(text), "%d %d 0 ", u, v);
  strcat(text, "]\n");
  i = import_text(text, "spline.rib");
  test_expect_ok(&i);
  bounds = lod_mesh_bounds(&i.model.units[0].mesh);
  assert_true(fabs(bounds.min[0] - 1) < 1e-6 && fabs(bounds.max[0] - 3) < 1e-6 && fabs(bounds.max[1] - 2) < 1e-6);
  test_import_end(&i);
}

static void what_is_wrong_is_told_by_line(void **state) {
  (void)state;
  expect("2\n1 1\n0 0 0\n0 1 0\n1 0 0\n1 1 0\n", "a.bpt", "truncated", "line 7 after 1");
  expect("1\n1 1\n0 0 0\n0 x 0\n1 0 0\n1 1 0\n", "a.bpt", "bad-syntax", "line 4");
  expect("1\n1 1\n0 0 0\n0 nan 0\n1 0 0\n1 1 0\n", "a.bpt", "non-finite", "line 6");
  expect("1\n10 1\n0 0 0\n", "a.bpt", "patch-degree", "line 2");
  expect("1\n0 1\n0 0 0\n", "a.bpt", "patch-degree", "line 2");
  expect("4000000000\n9 9\n0 0 0\n", "a.bpt", "truncated", "line 2");
  expect("-1\n", "a.bpt", "bad-syntax", "line 1");
  expect("1e99\n", "a.bpt", "bad-syntax", "line 1");
  expect("0\n", "a.bpt", "empty", "no patches");
  expect("8 1 1\n0 0 0 1\n1 0 0 1\n0 1 0 0\n1 1 0 1\n", "a.bv", "patch-weight", "line 5");
  expect("7 1 1\n", "a.bv", "patch-kind", "line 1");
  expect("BEZ113_ST\n0 0 0 1 0 0 0 1 0 1 1 0\n0 0 1 0 0 1 1\n", "a.bez", "truncated", "a texture coordinate");
  expect("WorldBegin\nPatch \"bicubic\" \"P\" [0 0 0]\n", "a.rib", "bad-syntax", "line 2");
  expect("TransformEnd\n", "a.rib", "bad-syntax", "line 1");
  expect("\nTrimCurve [1] [3] [0 0 0 1 1 1] [0] [1] [3] [0 0 0] [0 0 0] [1 1 1]\n", "a.rib", "trimmed-nurbs", "line 2");
  expect("NuPatch 4 4 [0 1 2 3 4 5 6 7] 3 4 4 4 [0 0 0 0 1 1 1 1] 0 1 \"P\" [0]", "a.rib", "nurbs-open", "line 1");
}

static void every_prefix_of_a_patch_file_is_refused_or_read(void **state) {
  (void)state;
  static const char kText[] = "1\n2 2\n0 0 0\n0 1 0.7\n0 2 0\n1 0 0\n1 1 0.3\n1 2 0\n2 0 0\n2 1 0.9\n2 2 10";
  for (size_t n = 0; n + 5 < sizeof kText - 1; n++) {
    struct test_import i = test_import_bytes(kText, n, "a.bpt");
    assert_true(i.status != LOD_OK);
    test_import_end(&i);
  }
}

/* P3-10: a quarter of a dome, whose pole is a side that is a point, beside a plain bicubic patch. Coordinates put every vertex on its
 * chart's cubic, within what cubics can do; sides that charts share have the same vertices. */
static void charts_say_where_triangles_lie_on_their_patches(void **state) {
  (void)state;
  char text[8192] = "2\n3 3\n";
  size_t at = strlen(text);
  for (int s = 0; s < 4; s++)
    for (int t = 0; t < 4; t++) /* t = 0: the pole */
      at += (size_t)snprintf(text + at, sizeof text - at, "%.17g %.17g %.17g\n", t / 3.0 * cos(s * 0.5), t / 3.0 * sin(s * 0.5),
                             t == 0   ? 0.5
                             : t == 1 ? 0.5
                             : t == 2 ? 0.35
                                      : 0);
  at += (size_t)snprintf(text + at, sizeof text - at, "3 3\n");
  for (int s = 0; s < 4; s++)
    for (int t = 0; t < 4; t++)
      at += (size_t)snprintf(text + at, sizeof text - at, "%g %g %g\n", 2 + s / 3.0, t / 3.0, (s % 3 == 0 || t % 3 == 0) ? 0.0 : 0.4);
  struct test_import i = import_text(text, "dome.bpt");
  test_expect_ok(&i);
  const struct lod_unit *unit = &i.model.units[0];
  const struct lod_charts *charts = unit->charts;
  assert_non_null(charts);
  assert_true(charts->count >= 3);
  double worst = 0;
  for (uint32_t t = 0; t < unit->mesh.triangle_count; t++) {
    assert_true(charts->of[t] < charts->count);
    struct lod_bezier net;
    for (int c = 0; c < 10; c++)
      net.p[c] = (struct lod_vec3){charts->nets[charts->of[t]][c][0], charts->nets[charts->of[t]][c][1], charts->nets[charts->of[t]][c][2]};
    for (int k = 0; k < 3; k++) {
      const float *b = charts->at[t][k];
      assert_true(b[0] >= 0 && b[1] >= 0 && b[2] >= 0 && fabsf(b[0] + b[1] + b[2] - 1) < 1e-5f);
      struct lod_vec3 p = lod_bezier_point(&net, (struct lod_barycentric){(double)b[0], (double)b[1], (double)b[2]});
      double distance = lod_vec3_distance(p, lod_vec3_from_float(unit->mesh.positions[unit->mesh.triangles[t][k]]));
      worst = fmax(worst, distance);
      if (b[0] == 1 || b[1] == 1 || b[2] == 1) /* corners are vertices */
        assert_true(distance < 1e-6);
    }
  }
  assert_true(worst < 0.03); /* of a diagonal of 3.2: the centre is the rule's, before it is fitted */
  struct lod_clod *clod;
  struct lod_clod_facts facts;
  struct lod_arena *arena = lod_arena_create(0);
  bool suitable;
  assert_int_equal(lod_clod_create_charts(&unit->mesh, charts, NULL, arena, &clod, &suitable, NULL), LOD_OK);
  assert_true(suitable && lod_clod_check(clod));
  lod_clod_facts(clod, &facts);
  assert_int_equal(facts.patches, charts->count);
  assert_true(facts.error < 0.005);
  assert_int_equal(lod_clod_simplify(clod, facts.patches / 2, INFINITY, NULL), LOD_OK);
  assert_true(lod_clod_check(clod));
  lod_arena_destroy(arena);
  test_import_end(&i);
}

static bool is_same_curve(const struct lod_patches *patches, uint32_t e, uint32_t f) {
  bool same = false;
  for (uint32_t turn = 0; turn < 2; turn++)
    same = same || (patches->ends[e][0] == patches->ends[f][turn] && patches->ends[e][1] == patches->ends[f][1 - turn] &&
                    lod_vec3_distance(patches->inner[e][0], patches->inner[f][turn]) == 0 &&
                    lod_vec3_distance(patches->inner[e][1], patches->inner[f][1 - turn]) == 0);
  return same;
}

/* Three pages that meet in a curved spine: no two of them are each other's neighbour, and yet the spine is one curve in every C-LOD. */
static void pages_that_share_a_spine_stay_together(void **state) {
  (void)state;
  char text[8192] = "3\n";
  size_t at = strlen(text);
  for (int page = 0; page < 3; page++) {
    at += (size_t)snprintf(text + at, sizeof text - at, "3 3\n");
    for (int s = 0; s < 4; s++)
      for (int t = 0; t < 4; t++)
        at += (size_t)snprintf(text + at, sizeof text - at, "%.17g %.17g %d\n", t * cos(2.1 * page) + (s == 1 || s == 2 ? 0.5 : 0),
                               t * sin(2.1 * page) + (t == 2 ? 0.3 * s : 0), s);
  }
  struct test_import i = import_text(text, "pages.bpt");
  test_expect_ok(&i);
  const struct lod_unit *unit = &i.model.units[0];
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_clod *clod;
  struct lod_clod_facts facts;
  struct lod_patches patches;
  bool suitable;
  assert_int_equal(lod_clod_create_charts(&unit->mesh, unit->charts, NULL, arena, &clod, &suitable, NULL), LOD_OK);
  assert_true(suitable && lod_clod_check(clod));
  uint32_t first = 0;
  for (uint32_t wanted = unit->charts->count;; wanted = 0) {
    assert_int_equal(lod_clod_simplify(clod, wanted, INFINITY, NULL), LOD_OK);
    assert_true(lod_clod_check(clod));
    lod_clod_facts(clod, &facts);
    assert_int_equal(lod_clod_extract(clod, facts.clod, arena, &patches, NULL), LOD_OK);
    /* Each curve of the spine three times over, as at first. (Two pages may end as slivers whose borders have the same ends as well.) */
    uint32_t met = 0;
    for (uint32_t e = 0; e < patches.edge_count; e++)
      for (uint32_t f = e + 1; f < patches.edge_count; f++)
        met += is_same_curve(&patches, e, f);
    if (wanted > 0)
      first = met;
    assert_true(met >= 3 && met == first);
    if (wanted == 0)
      break;
  }
  assert_true(facts.patches <= unit->charts->count);
  lod_arena_destroy(arena);
  test_import_end(&i);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_bilinear_patch_is_two_triangles),
      cmocka_unit_test(a_parabola_is_met_within_the_rounding_told),
      cmocka_unit_test(a_polyhedron_of_n_gons_is_read_with_patches),
      cmocka_unit_test(normals_behind_points_are_passed_over),
      cmocka_unit_test(a_patch_file_needs_no_ending),
      cmocka_unit_test(patches_that_share_an_edge_share_its_vertices),
      cmocka_unit_test(a_collapsed_side_leaves_no_flat_triangle),
      cmocka_unit_test(bezierview_triangles_and_rational_patches_are_read),
      cmocka_unit_test(geomview_names_its_degrees),
      cmocka_unit_test(a_nurbs_cylinder_is_round),
      cmocka_unit_test(knots_are_inserted_up_to_bezier),
      cmocka_unit_test(rib_transforms_and_bases_apply),
      cmocka_unit_test(what_is_wrong_is_told_by_line),
      cmocka_unit_test(a_limit_of_vertices_ends_the_cutting),
      cmocka_unit_test(every_prefix_of_a_patch_file_is_refused_or_read),
      cmocka_unit_test(charts_say_where_triangles_lie_on_their_patches),
      cmocka_unit_test(pages_that_share_a_spine_stay_together),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
