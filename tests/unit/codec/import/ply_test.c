#include "tests/unit/codec/import/importing.h"

#include <math.h>

#define HEADER(encoding, rest) "ply\nformat " encoding " 1.0\ncomment a test\n" rest "end_header\n"
#define XYZ "property float x\nproperty float y\nproperty float z\n"
#define FACES "property list uchar int vertex_indices\n"

static struct test_import import_text(const char *text) {
  return test_import_bytes(text, strlen(text), "test.ply");
}

static void a_triangle_in_ascii_keeps_its_corners_and_has_no_rounding(void **state) {
  (void)state;
  struct test_import i =
      import_text(HEADER("ascii", "element vertex 3\n" XYZ "element face 1\n" FACES) "0 0 0\n1 0 0\n0 .5 -1e0\n3 0 1 2\n");
  test_expect_ok(&i);
  assert_string_equal(i.model.format, "ply");
  assert_int_equal(i.model.source_vertices, 3);
  assert_int_equal(i.model.source_triangles, 1);
  assert_int_equal(i.model.part_count, 1);
  assert_true(i.model.rounding == 0);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->vertex_count, 3);
  assert_null(mesh->normals);
  assert_true(mesh->positions[mesh->triangles[0][2]][1] == 0.5f && mesh->positions[mesh->triangles[0][2]][2] == -1);
  test_import_end(&i);
}

static void a_concave_pentagon_becomes_three_triangles_of_its_area(void **state) {
  (void)state;
  struct test_import i =
      import_text(HEADER("ascii", "element vertex 5\n" XYZ "element face 1\n" FACES) "0 0 0\n4 0 0\n4 4 0\n2 1 0\n0 4 0\n5 0 1 2 3 4\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  double area = 0;
  assert_int_equal(mesh->triangle_count, 3);
  for (uint32_t t = 0; t < 3; t++) {
    const float *a = mesh->positions[mesh->triangles[t][0]], *b = mesh->positions[mesh->triangles[t][1]],
                *c = mesh->positions[mesh->triangles[t][2]];
    area += ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2;
  }
  assert_true(area == 10); /* the square's 16 less the notch's 6, no triangle turned over */
  test_import_end(&i);
}

static void doubles_far_from_the_origin_are_rounded_within_the_stated_bound(void **state) {
  (void)state;
  struct test_import i = import_text(HEADER("ascii", "element vertex 3\nproperty double x\nproperty double y\nproperty double z\n"
                                                     "element face 1\n" FACES) "4000000.3 0 0\n4000001.1 0 0\n4000000.3 1 0\n3 0 1 2\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  double off = fabs((double)mesh->positions[mesh->triangles[0][0]][0] - 4000000.3);
  assert_true(off > 0 && i.model.rounding >= off && i.model.rounding < 0.5);
  test_import_end(&i);
}

static void put_big(struct test_bytes *to, const void *value, size_t size) {
  uint8_t turned[8];
  for (size_t k = 0; k < size; k++)
    turned[k] = ((const uint8_t *)value)[size - 1 - k];
  test_append(to, turned, size);
}

static struct test_bytes big_endian_square(void) {
  static const double corners[4][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
  static const uint32_t quad[4] = {0, 1, 2, 3};
  struct test_bytes ply = {0};
  const char *header = HEADER("binary_big_endian", "element vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
                                                   "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                                                   "element face 1\nproperty list ushort uint vertex_index\nproperty short flags\n");
  const uint16_t four = 4;
  test_append(&ply, header, strlen(header));
  for (int v = 0; v < 4; v++) {
    for (int k = 0; k < 3; k++)
      put_big(&ply, &corners[v][k], 8);
    test_append(&ply, "\xFF\x80\x00", 3);
  }
  put_big(&ply, &four, 2);
  for (int k = 0; k < 4; k++)
    put_big(&ply, &quad[k], 4);
  test_append(&ply, "\x01\x02", 2);
  return ply;
}

static void a_big_endian_quad_of_doubles_keeps_its_colours_as_linear_light(void **state) {
  (void)state;
  struct test_bytes ply = big_endian_square();
  struct test_import i = test_import_bytes(ply.bytes, ply.size, "square.ply");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->triangle_count, 2);
  assert_int_equal(mesh->vertex_count, 4);
  assert_non_null(mesh->colors);
  assert_true(i.model.parts[0].has_colors && !i.model.parts[0].has_normals);
  assert_true(mesh->colors[0][0] == 1 && fabsf(mesh->colors[0][1] - 0.2158605f) < 1e-5f && mesh->colors[0][2] == 0 &&
              mesh->colors[0][3] == 1);
  assert_true(i.model.rounding == 0);
  test_import_end(&i);
  free(ply.bytes);
}

static void every_prefix_of_a_file_is_refused(void **state) {
  (void)state;
  struct test_bytes ply = big_endian_square();
  for (size_t n = 0; n < ply.size; n++) {
    struct test_import i = test_import_bytes(ply.bytes, n, "square.ply");
    assert_true(i.status != LOD_OK);
    test_import_end(&i);
  }
  free(ply.bytes);
}

static void faces_with_colours_split_the_vertices_into_wedges(void **state) {
  (void)state;
  struct test_import i = import_text(HEADER(
      "ascii",
      "element vertex 4\n" XYZ "element face 2\n" FACES
      "property uchar red\nproperty uchar green\nproperty uchar blue\n") "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 255 0 0\n3 0 2 3 0 255 0\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->vertex_count, 4);
  assert_int_equal(mesh->wedge_count, 6);
  assert_true(mesh->colors[mesh->corners[0][0]][0] == 1 && mesh->colors[mesh->corners[1][0]][1] == 1);
  test_import_end(&i);
}

static void an_interest_of_the_model_travels_as_alpha(void **state) {
  (void)state;
  struct test_import i = import_text(
      HEADER("ascii", "element vertex 3\n" XYZ "property float doi\nelement face 1\n" FACES) "0 0 0 0.25\n1 0 0 7\n1 1 0 -1\n3 0 1 2\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  const float expected[3] = {0.25f, 1, 0};
  for (int k = 0; k < 3; k++) {
    const float *color = mesh->colors[mesh->corners[0][k]];
    assert_true(color[0] == 1 && color[1] == 1 && color[2] == 1 && color[3] == expected[k]);
  }
  test_import_end(&i);
  i = import_text(
      HEADER("ascii", "element vertex 3\n" XYZ "property uchar interest\nproperty uchar red\nproperty uchar green\n"
                      "property uchar blue\nproperty uchar alpha\nelement face 1\n" FACES) "0 0 0 51 255 0 0 255\n1 0 0 0 0 255 0 "
                                                                                           "255\n1 1 0 255 0 0 255 0\n3 0 1 2\n");
  test_expect_ok(&i);
  mesh = &i.model.units[0].mesh;
  assert_true(mesh->colors[mesh->corners[0][0]][3] == 51 * (1 / 255.0f) && mesh->colors[mesh->corners[0][0]][0] == 1);
  assert_true(mesh->colors[mesh->corners[0][2]][3] == 1 && mesh->colors[mesh->corners[0][2]][2] == 1);
  test_import_end(&i);
}

static void corner_texcoords_are_kept_and_turned_upside_down(void **state) {
  (void)state;
  struct test_import i =
      import_text(HEADER("ascii", "element vertex 3\n" XYZ "element face 1\n" FACES
                                  "property list uchar float texcoord\n") "0 0 0\n1 0 0\n0 1 0\n3 0 1 2 6 0 0 1 0 0 0.25\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_true(i.model.parts[0].has_uv[0]);
  assert_true(mesh->uvs[0][mesh->corners[0][2]][1] == 0.75f && mesh->uvs[0][mesh->corners[0][1]][0] == 1);
  test_import_end(&i);
}

static void a_triangle_strip_turns_every_other_triangle_over(void **state) {
  (void)state;
  struct test_import i = import_text(
      HEADER("ascii", "element vertex 4\n" XYZ
                      "element tristrips 1\nproperty list int int vertex_indices\n") "0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 0 1 2\n");
  test_expect_ok(&i);
  const struct lod_mesh *mesh = &i.model.units[0].mesh;
  assert_int_equal(mesh->triangle_count, 3);
  for (uint32_t t = 0; t < 3; t++) {
    const float *a = mesh->positions[mesh->triangles[t][0]], *b = mesh->positions[mesh->triangles[t][1]],
                *c = mesh->positions[mesh->triangles[t][2]];
    assert_true((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0);
  }
  test_import_end(&i);
}

static void edges_become_free_segments(void **state) {
  (void)state;
  struct test_import i = import_text(
      HEADER("ascii", "element vertex 4\n" XYZ "element face 1\n" FACES
                      "element edge 1\nproperty int vertex1\nproperty int vertex2\n") "0 0 0\n1 0 0\n0 1 0\n5 5 5\n3 0 1 2\n2 3\n");
  test_expect_ok(&i);
  assert_int_equal(i.model.units[0].mesh.edge_count, 1);
  test_import_end(&i);
}

static void lies_and_nonsense_get_a_problem_of_their_kind(void **state) {
  (void)state;
  test_expect_problem(import_text(HEADER("ascii", "element vertex 3\n" XYZ "element face 1\n" FACES) "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n"),
                      "index-out-of-range");
  test_expect_problem(import_text(HEADER("ascii", "element vertex 3\n" XYZ "element face 1\n" FACES) "0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n"),
                      "index-out-of-range");
  test_expect_problem(import_text(HEADER("ascii", "element vertex 3\n" XYZ "element face 1\n" FACES) "0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n"),
                      "non-finite");
  test_expect_problem(
      import_text(HEADER("ascii", "element vertex 3\n" XYZ "element face 999999999\n" FACES) "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"),
      "truncated");
  test_expect_problem(import_text(HEADER("ascii", "element vertex 3\n" XYZ "element face 1\n" FACES) "0 0 0\n1 0 x\n0 1 0\n3 0 1 2\n"),
                      "bad-number");
  test_expect_problem(import_text(HEADER("ascii", "element vertex 1\n" XYZ) "0 0 0\n"), "empty");
  test_expect_problem(import_text(HEADER("ascii", "element face 0\n" FACES)), "bad-header");
  test_expect_problem(import_text(HEADER("middle_endian", "element vertex 1\n" XYZ) "0 0 0\n"), "bad-header");
  test_expect_problem(import_text("ply\nformat ascii 1.0\nelement vertex 3\n"), "truncated");
  test_expect_problem(import_text(""), "empty");
}

/* Found by the fuzzer: the exact predicates must never see a NaN. */
static void nan_in_a_triangle_beside_a_quad_is_refused(void **state) {
  (void)state;
  test_expect_problem(import_text(HEADER("ascii", "element vertex 5\n" XYZ
                                                  "element face 2\n" FACES) "0 0 0\n1 0 0\n1 1 0\n0 1 0\nnan 5 0\n4 0 1 2 3\n3 0 1 4\n"),
                      "non-finite");
}

static void nan_in_a_vertex_that_no_face_uses_is_harmless(void **state) {
  (void)state;
  struct test_import i =
      import_text(HEADER("ascii", "element vertex 4\n" XYZ "element face 1\n" FACES) "0 0 0\n1 0 0\n0 1 0\nnan inf 0\n3 0 1 2\n");
  test_expect_ok(&i);
  assert_int_equal(i.model.units[0].mesh.vertex_count, 3);
  test_import_end(&i);
}

static void limits_are_kept_before_anything_is_allocated(void **state) {
  (void)state;
  const char *text = HEADER("ascii", "element vertex 3\n" XYZ "element face 1\n" FACES) "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
  struct lod_import_limits limits = lod_import_limits_defaults();
  limits.max_vertices = 2;
  test_expect_problem(test_import_with(text, strlen(text), "a.ply", NULL, &limits), "limit-vertices");
  limits = lod_import_limits_defaults();
  limits.max_bytes = 20;
  test_expect_problem(test_import_with(text, strlen(text), "a.ply", NULL, &limits), "limit-bytes");
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(a_triangle_in_ascii_keeps_its_corners_and_has_no_rounding),
      cmocka_unit_test(a_concave_pentagon_becomes_three_triangles_of_its_area),
      cmocka_unit_test(doubles_far_from_the_origin_are_rounded_within_the_stated_bound),
      cmocka_unit_test(a_big_endian_quad_of_doubles_keeps_its_colours_as_linear_light),
      cmocka_unit_test(every_prefix_of_a_file_is_refused),
      cmocka_unit_test(an_interest_of_the_model_travels_as_alpha),
      cmocka_unit_test(faces_with_colours_split_the_vertices_into_wedges),
      cmocka_unit_test(corner_texcoords_are_kept_and_turned_upside_down),
      cmocka_unit_test(a_triangle_strip_turns_every_other_triangle_over),
      cmocka_unit_test(edges_become_free_segments),
      cmocka_unit_test(lies_and_nonsense_get_a_problem_of_their_kind),
      cmocka_unit_test(nan_in_a_triangle_beside_a_quad_is_refused),
      cmocka_unit_test(nan_in_a_vertex_that_no_face_uses_is_harmless),
      cmocka_unit_test(limits_are_kept_before_anything_is_allocated),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
