#include "codec/export/draco.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "tests/data/shapes.h"

/* A mesh on a grid, ready to encode. */
struct sample {
  struct lod_draco_encode_request request;
  int32_t (*indices)[3];
  uint8_t *bytes;
  size_t size;
  uint32_t points, triangles;
};

static struct lod_draco_grid grid_of(const struct lod_mesh *mesh, double step) {
  float min[3], max[3];
  memcpy(min, mesh->positions[0], sizeof min);
  memcpy(max, mesh->positions[0], sizeof max);
  for (uint32_t v = 1; v < mesh->vertex_count; v++)
    for (int i = 0; i < 3; i++) {
      min[i] = fminf(min[i], mesh->positions[v][i]);
      max[i] = fmaxf(max[i], mesh->positions[v][i]);
    }
  return lod_draco_grid_make(min, max, 3, step);
}

static struct sample sample_of(struct lod_arena *arena, const struct lod_mesh *mesh, double step) {
  struct sample sample = {0};
  sample.request.grid = grid_of(mesh, step);
  sample.indices = lod_arena_alloc(arena, mesh->vertex_count, sizeof *sample.indices);
  assert_non_null(sample.indices);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int i = 0; i < 3; i++)
      sample.indices[v][i] = lod_draco_grid_index(&sample.request.grid, i, mesh->positions[v][i]);
  sample.request.vertex_count = sample.request.point_count = mesh->vertex_count;
  sample.request.positions = (const int32_t(*)[3])sample.indices;
  sample.request.triangle_count = mesh->triangle_count;
  sample.request.triangles = (const uint32_t(*)[3])mesh->triangles;
  sample.request.speed = 3;
  return sample;
}

static void encode(struct lod_arena *arena, struct sample *sample) {
  struct lod_problem problem = {0};
  enum lod_status status =
      lod_draco_encode(&sample->request, arena, &sample->bytes, &sample->size, &sample->points, &sample->triangles, &problem);
  if (status != LOD_OK)
    fail_msg("encode: %s", problem.detail);
}

static struct lod_draco_mesh decode(struct lod_arena *arena, const struct sample *sample) {
  struct lod_draco_mesh mesh;
  struct lod_problem problem = {0};
  if (lod_draco_decode(sample->bytes, sample->size, NULL, arena, &mesh, &problem) != LOD_OK)
    fail_msg("decode: %s", problem.detail);
  assert_int_equal(mesh.point_count, sample->points);
  assert_int_equal(mesh.triangle_count, sample->triangles);
  return mesh;
}

/* A triangle as nine coordinates, turned to the least of its three rotations, so that equal triangles have equal bytes. */
struct nine {
  float c[9];
};

static struct nine canonical(const float a[3], const float b[3], const float c[3]) {
  const float *corner[3] = {a, b, c};
  struct nine least;
  for (int first = 0; first < 3; first++) {
    struct nine turned;
    for (int i = 0; i < 3; i++)
      memcpy(turned.c + 3 * i, corner[(first + i) % 3], 12);
    if (first == 0 || memcmp(&turned, &least, sizeof least) < 0)
      least = turned;
  }
  return least;
}

static int compare_nine(const void *a, const void *b) {
  return memcmp(a, b, sizeof(struct nine));
}

/* Every triangle of the request, with its orientation and as often as it occurs, came out, each coordinate to the bit. */
static void assert_same_triangles(struct lod_arena *arena, const struct sample *sample, const struct lod_draco_mesh *mesh) {
  const struct lod_draco_encode_request *request = &sample->request;
  assert_int_equal(mesh->triangle_count, request->triangle_count);
  const struct lod_draco_attribute *attribute = lod_draco_find(mesh, 0);
  assert_non_null(attribute);
  const float(*positions)[3] = attribute->values;
  struct nine *expected = LOD_NEW(arena, request->triangle_count, struct nine), *got = LOD_NEW(arena, request->triangle_count, struct nine);
  for (uint32_t t = 0; t < request->triangle_count; t++) {
    float corner[3][3];
    for (int c = 0; c < 3; c++) {
      uint32_t point = request->triangles[t][c], vertex = request->point_vertices != NULL ? request->point_vertices[point] : point;
      for (int i = 0; i < 3; i++)
        corner[c][i] = lod_draco_grid_point(&request->grid, i, request->positions[vertex][i]);
    }
    expected[t] = canonical(corner[0], corner[1], corner[2]);
    const uint32_t *triangle = mesh->triangles[t];
    got[t] = canonical(positions[triangle[0]], positions[triangle[1]], positions[triangle[2]]);
  }
  qsort(expected, request->triangle_count, sizeof *expected, compare_nine);
  qsort(got, request->triangle_count, sizeof *got, compare_nine);
  assert_memory_equal(expected, got, request->triangle_count * sizeof *expected);
}

static void every_point_of_a_grid_is_a_float_without_rounding(void **state) {
  (void)state;
  uint64_t random = 7;
  for (int trial = 0; trial < 20000; trial++) {
    float min[3], max[3];
    double scale = ldexp(1, (int)(lod_random_next(&random) % 60) - 30), offset = ldexp(1, (int)(lod_random_next(&random) % 20)) * scale;
    for (int i = 0; i < 3; i++) {
      min[i] = (float)((lod_random_unit(&random) - 0.5) * offset);
      max[i] = min[i] + (float)(lod_random_unit(&random) * scale);
    }
    double wanted = scale * ldexp(lod_random_unit(&random), -(int)(lod_random_next(&random) % 26));
    struct lod_draco_grid grid = lod_draco_grid_make(min, max, 3, wanted);
    assert_in_range(grid.bits, 1, 24);
    float last = (float)(ldexp(1, grid.bits) - 1), range = last * grid.step;
    assert_true((double)range == (double)last * (double)grid.step);
    assert_true(range / last == grid.step); /* what Draco's decoder computes */
    for (int i = 0; i < 3; i++) {
      int32_t q = lod_draco_grid_index(&grid, i, min[i] + (float)lod_random_unit(&random) * (max[i] - min[i]));
      float point = lod_draco_grid_point(&grid, i, q);
      assert_true((double)point == (double)grid.origin[i] + (double)q * (double)grid.step);
      int32_t again = (int32_t)floorf((point - grid.origin[i]) * (last / range) + 0.5f); /* what Draco's encoder computes */
      assert_int_equal(again, q);
      assert_true(fabs((double)lod_draco_grid_point(&grid, i, lod_draco_grid_index(&grid, i, max[i])) - (double)max[i]) <=
                  (double)grid.step / 2);
      assert_true(fabs((double)lod_draco_grid_point(&grid, i, lod_draco_grid_index(&grid, i, min[i])) - (double)min[i]) <=
                  (double)grid.step / 2);
    }
  }
}

static void a_grid_is_no_coarser_than_asked_where_floats_allow(void **state) {
  (void)state;
  const float min[3] = {-1, -1, -1}, max[3] = {1, 1, 1};
  for (double step = 0.5; step > 1e-6; step *= 0.7) {
    struct lod_draco_grid grid = lod_draco_grid_make(min, max, 3, step);
    assert_true((double)grid.step <= step);
    assert_true((double)grid.step >= step * 0.49);
    if (grid.bits >= 7 && grid.bits <= 16) /* and hardly finer, which would cost bytes */
      assert_true((double)grid.step >= step * 0.96);
  }
}

static void a_torus_comes_back_bit_exact_at_every_speed(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh torus = lod_shape_torus(arena, 1000, 0.3, 60, 20);
  for (int speed = 0; speed <= 10; speed++)
    for (double step = 1; step > 1e-5; step /= 30) {
      struct sample sample = sample_of(arena, &torus, step);
      sample.request.speed = speed;
      encode(arena, &sample);
      struct lod_draco_mesh mesh = decode(arena, &sample);
      /* Where the tube is thinner than the grid, triangles collapse and Draco drops none of them: corners stay different vertices. */
      assert_same_triangles(arena, &sample, &mesh);
    }
  lod_arena_destroy(arena);
}

static void a_soup_of_duplicates_and_fins_keeps_every_triangle(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  /* Five fins on one edge, one of them twice, one of them in both orientations, and a bow tie. */
  float positions[][3] = {{0, 0, 0}, {0, 0, 1}, {1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, -1, 0}, {1, 1, 0}, {2, 0, 2}, {2, 1, 2}};
  uint32_t triangles[][3] = {{0, 1, 2}, {0, 1, 3}, {0, 1, 4}, {0, 1, 5}, {0, 1, 6}, {0, 1, 6}, {1, 0, 5}, {2, 7, 8}, {2, 3, 6}};
  struct lod_mesh mesh = {.vertex_count = 9, .triangle_count = 9, .positions = positions, .triangles = triangles};
  for (int speed = 0; speed <= 10; speed++)
    for (int sequential = 0; sequential < 2; sequential++) {
      struct sample sample = sample_of(arena, &mesh, 0.01);
      sample.request.speed = speed;
      sample.request.sequential = sequential;
      encode(arena, &sample);
      struct lod_draco_mesh decoded = decode(arena, &sample);
      assert_same_triangles(arena, &sample, &decoded);
    }
  struct lod_mesh soup = lod_shape_soup(arena, 500, 0.2, 3);
  struct sample sample = sample_of(arena, &soup, 0.001);
  encode(arena, &sample);
  struct lod_draco_mesh decoded = decode(arena, &sample);
  assert_same_triangles(arena, &sample, &decoded);
  lod_arena_destroy(arena);
}

/* A grid of quads cut by a UV seam along its middle column and with a normal that is flat on each half. */
static void uv_and_normal_seams_stay_where_they_are(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  enum { N = 8, SIDE = N + 1 };
  struct lod_mesh grid = lod_shape_grid(arena, 1, N, 0.1);
  assert_int_equal(grid.vertex_count, SIDE * SIDE);
  uint32_t *vertex = LOD_NEW(arena, 2 * grid.vertex_count, uint32_t), *value = LOD_NEW(arena, 2 * grid.vertex_count, uint32_t);
  float(*uv)[2] = lod_arena_alloc(arena, 2 * grid.vertex_count, sizeof *uv);
  float(*normal)[3] = lod_arena_alloc(arena, 2 * grid.vertex_count, sizeof *normal);
  uint8_t(*color)[4] = lod_arena_alloc(arena, 2 * grid.vertex_count, sizeof *color);
  uint32_t count = grid.vertex_count;
  uint32_t *second = LOD_NEW(arena, grid.vertex_count, uint32_t);
  for (uint32_t v = 0; v < grid.vertex_count; v++) {
    vertex[v] = value[v] = second[v] = v;
    if (fabs((double)grid.positions[v][0]) < 1e-6) {
      second[v] = count;
      vertex[count] = v;
      value[count] = count;
      count++;
    }
  }
  for (uint32_t p = 0; p < count; p++) {
    bool right = p >= grid.vertex_count || grid.positions[vertex[p]][0] > 1e-6f;
    uv[p][0] = (float)((double)grid.positions[vertex[p]][0] + 0.5 + (right ? 3 : 0));
    uv[p][1] = grid.positions[vertex[p]][1] + 0.5f;
    normal[p][0] = right ? 0.6f : -0.6f;
    normal[p][1] = 0;
    normal[p][2] = 0.8f;
    memcpy(color[p], (uint8_t[4]){right ? 255 : 0, (uint8_t)(p % 256), 7, 255}, 4);
  }
  for (uint32_t t = 0; t < grid.triangle_count; t++) {
    double centre = 0;
    for (int c = 0; c < 3; c++)
      centre += (double)grid.positions[grid.triangles[t][c]][0];
    for (int c = 0; c < 3 && centre > 0; c++)
      grid.triangles[t][c] = second[grid.triangles[t][c]];
  }
  const float low[2] = {0, 0}, high[2] = {4, 1};
  struct lod_draco_input inputs[3] = {
      {.kind = LOD_DRACO_NORMAL,
       .component = LOD_DRACO_FLOAT,
       .components = 3,
       .unique_id = 1,
       .values = normal,
       .value_count = count,
       .point_values = value,
       .bits = 8},
      {.kind = LOD_DRACO_TEXCOORD,
       .component = LOD_DRACO_FLOAT,
       .components = 2,
       .unique_id = 2,
       .values = uv,
       .value_count = count,
       .point_values = value,
       .grid = lod_draco_grid_make(low, high, 2, 0x1p-12)},
      {.kind = LOD_DRACO_COLOR,
       .component = LOD_DRACO_UINT8,
       .components = 4,
       .unique_id = 3,
       .values = color,
       .value_count = count,
       .point_values = value},
  };
  for (int speed = 0; speed <= 10; speed++) {
    struct sample sample = sample_of(arena, &grid, 0.001);
    sample.request.point_count = count;
    sample.request.point_vertices = vertex;
    sample.request.inputs = inputs;
    sample.request.input_count = 3;
    sample.request.speed = speed;
    encode(arena, &sample);
    struct lod_draco_mesh mesh = decode(arena, &sample);
    assert_int_equal(mesh.point_count, count);
    assert_same_triangles(arena, &sample, &mesh);
    const float(*p)[3] = lod_draco_find(&mesh, 0)->values;
    const float(*u)[2] = lod_draco_find(&mesh, 2)->values;
    float *n = lod_draco_floats(&mesh, lod_draco_find(&mesh, 1), arena);
    float *c = lod_draco_floats(&mesh, lod_draco_find(&mesh, 3), arena);
    assert_int_equal(lod_draco_find(&mesh, 3)->component, LOD_DRACO_UINT8);
    for (uint32_t i = 0; i < mesh.point_count; i++) {
      bool right = u[i][0] > 2;
      assert_float_equal(u[i][0], (double)p[i][0] + 0.5 + (right ? 3 : 0), 0.002);
      assert_float_equal(u[i][1], (double)p[i][1] + 0.5, 0.002);
      assert_true(right ? p[i][0] > -0.001f : p[i][0] < 0.001f);
      assert_float_equal(n[3 * i], right ? 0.6 : -0.6, 0.02);
      assert_float_equal(c[4 * i], right ? 1 : 0, 0);
      assert_float_equal(c[4 * i + 3], 1, 0);
    }
  }
  lod_arena_destroy(arena);
}

static void the_same_mesh_gives_the_same_bytes(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.3, 60, 20);
  struct sample a = sample_of(arena, &torus, 0.001), b = sample_of(arena, &torus, 0.001);
  encode(arena, &a);
  encode(arena, &b);
  assert_int_equal(a.size, b.size);
  assert_memory_equal(a.bytes, b.bytes, a.size);
  lod_arena_destroy(arena);
}

static void every_prefix_of_a_buffer_is_refused_or_whole(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh cube = lod_shape_torus(arena, 1, 0.3, 9, 7);
  for (int sequential = 0; sequential < 2; sequential++) {
    struct sample sample = sample_of(arena, &cube, 0.01);
    sample.request.sequential = sequential;
    encode(arena, &sample);
    size_t refused = 0;
    for (size_t size = 0; size < sample.size; size++) {
      uint8_t *prefix = malloc(size + (size == 0));
      memcpy(prefix, sample.bytes, size);
      struct lod_arena *scratch = lod_arena_create(0);
      struct lod_draco_mesh mesh;
      struct lod_problem problem = {0};
      if (lod_draco_decode(prefix, size, NULL, scratch, &mesh, &problem) != LOD_OK) {
        assert_string_not_equal(problem.detail, "");
        refused++;
      }
      lod_arena_destroy(scratch);
      free(prefix);
    }
    assert_true(refused + 8 >= sample.size); /* the last bytes of an entropy coder may be padding */
  }
  lod_arena_destroy(arena);
}

static void declared_counts_are_refused_before_decoding(void **state) {
  (void)state;
  /* Sequential header: 2^28 - 1 triangles over as many points in 40 bytes. */
  uint8_t bomb[40] = {'D', 'R', 'A', 'C', 'O', 2, 2, 1, 0, 0, 0, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff, 0x7f, 0};
  struct lod_arena *arena = lod_arena_create(1 << 20);
  struct lod_draco_mesh mesh;
  struct lod_problem problem = {0};
  assert_int_equal(lod_draco_decode(bomb, sizeof bomb, NULL, arena, &mesh, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "count-implausible");
  /* Few triangles over very many points, and the same with Edgebreaker. */
  uint8_t points[40] = {'D', 'R', 'A', 'C', 'O', 2, 2, 1, 0, 0, 0, 1, 0xff, 0xff, 0xff, 0x7f, 1};
  problem = (struct lod_problem){0};
  assert_int_equal(lod_draco_decode(points, sizeof points, NULL, arena, &mesh, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "count-implausible");
  uint8_t edgebreaker[40] = {'D', 'R', 'A', 'C', 'O', 2, 2, 1, 1, 0, 0, 0, 4, 0xff, 0xff, 0xff, 0x7f, 0, 4, 0};
  problem = (struct lod_problem){0};
  assert_int_equal(lod_draco_decode(edgebreaker, sizeof edgebreaker, NULL, arena, &mesh, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "count-implausible");
  /* A plausible count over the caller's limit. */
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.3, 20, 10);
  struct sample sample = sample_of(arena, &torus, 0.01);
  encode(arena, &sample);
  problem = (struct lod_problem){0};
  assert_int_equal(lod_draco_decode(sample.bytes, sample.size, &(struct lod_draco_limits){.max_triangles = 399}, arena, &mesh, &problem),
                   LOD_LIMIT);
  assert_string_equal(problem.type, "limit-triangles");
  problem = (struct lod_problem){0};
  assert_int_equal(lod_draco_decode(sample.bytes, sample.size, &(struct lod_draco_limits){.max_vertices = 199}, arena, &mesh, &problem),
                   LOD_LIMIT);
  assert_string_equal(problem.type, "limit-vertices");
  assert_int_equal(lod_draco_decode(sample.bytes, sample.size, &(struct lod_draco_limits){200, 400}, arena, &mesh, NULL), LOD_OK);
  lod_arena_destroy(arena);
}

static void a_flat_grid_of_many_triangles_a_byte_is_no_bomb(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh grid = lod_shape_grid(arena, 300, 300, 0);
  struct sample sample = sample_of(arena, &grid, 1);
  sample.request.speed = 0;
  encode(arena, &sample);
  decode(arena, &sample);
  assert_true(grid.triangle_count > 100 * sample.size);
  lod_arena_destroy(arena);
}

static void metadata_before_the_mesh_is_skipped(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh cube = lod_shape_cube(arena, 1);
  struct sample sample = sample_of(arena, &cube, 0.01);
  encode(arena, &sample);
  /* One attribute's metadata (id 0) with one entry a = {9}, then the mesh's with one child b with nothing. */
  const uint8_t metadata[] = {1, 0, 1, 1, 'a', 1, 9, 0, 0, 1, 1, 'b', 0, 0};
  size_t size = sample.size + sizeof metadata;
  uint8_t *bytes = malloc(size);
  memcpy(bytes, sample.bytes, 11);
  bytes[10] |= 0x80;
  memcpy(bytes + 11, metadata, sizeof metadata);
  memcpy(bytes + 11 + sizeof metadata, sample.bytes + 11, sample.size - 11);
  struct lod_draco_header plain, with;
  assert_int_equal(lod_draco_inspect(sample.bytes, sample.size, &plain, NULL), LOD_OK);
  assert_int_equal(lod_draco_inspect(bytes, size, &with, NULL), LOD_OK);
  assert_true(with.mesh);
  assert_int_equal(plain.declared_triangles, with.declared_triangles);
  assert_int_equal(plain.declared_vertices, with.declared_vertices);
  struct lod_draco_mesh mesh;
  struct lod_problem problem = {0};
  assert_int_equal(lod_draco_decode(bytes, size, NULL, arena, &mesh, &problem), LOD_OK);
  assert_int_equal(mesh.triangle_count, 12);
  free(bytes);
  /* A thousand children deep: refused, not recursed into. */
  uint8_t deep[11 + 4 * 1000] = {'D', 'R', 'A', 'C', 'O', 2, 2, 1, 1, 0, 0x80};
  for (size_t i = 12; i + 2 < sizeof deep; i += 3) {
    deep[i] = 0;
    deep[i + 1] = 1;
    deep[i + 2] = 0;
  }
  assert_int_equal(lod_draco_decode(deep, sizeof deep, NULL, arena, &mesh, NULL), LOD_BAD_INPUT);
  lod_arena_destroy(arena);
}

static void a_bunny_that_others_encoded_decodes(void **state) {
  (void)state;
  const char *shared = getenv("LODESTREAM_SHARED");
  char path[1024];
  snprintf(path, sizeof path, "%s/models/gltf/bunny_gltf.drc", shared != NULL ? shared : "../shared");
  FILE *file = fopen(path, "rb");
  if (file == NULL)
    return;
  struct lod_arena *arena = lod_arena_create(0);
  uint8_t *bytes = lod_arena_alloc(arena, 1 << 22, 1);
  size_t size = fread(bytes, 1, 1 << 22, file);
  fclose(file);
  struct lod_draco_mesh mesh;
  struct lod_problem problem = {0};
  if (lod_draco_decode(bytes, size, NULL, arena, &mesh, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  struct lod_draco_header header;
  assert_int_equal(lod_draco_inspect(bytes, size, &header, NULL), LOD_OK);
  assert_int_equal(header.declared_triangles, mesh.triangle_count);
  assert_true(mesh.triangle_count > 60000);
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_point_of_a_grid_is_a_float_without_rounding),
      cmocka_unit_test(a_grid_is_no_coarser_than_asked_where_floats_allow),
      cmocka_unit_test(a_torus_comes_back_bit_exact_at_every_speed),
      cmocka_unit_test(a_soup_of_duplicates_and_fins_keeps_every_triangle),
      cmocka_unit_test(uv_and_normal_seams_stay_where_they_are),
      cmocka_unit_test(the_same_mesh_gives_the_same_bytes),
      cmocka_unit_test(every_prefix_of_a_buffer_is_refused_or_whole),
      cmocka_unit_test(declared_counts_are_refused_before_decoding),
      cmocka_unit_test(a_flat_grid_of_many_triangles_a_byte_is_no_bomb),
      cmocka_unit_test(metadata_before_the_mesh_is_skipped),
      cmocka_unit_test(a_bunny_that_others_encoded_decodes),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
