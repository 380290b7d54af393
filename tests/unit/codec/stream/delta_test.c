#include "codec/stream/delta.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/stream/bytes.h"
#include "core/mesh/topology.h"
#include "core/retile/retile.h"
#include "tests/data/arena.h"
#include "tests/data/models.h"
#include "tests/data/nested.h"
#include "tests/data/shapes.h"

/* --- an encoded step --- */

struct frame {
  struct lod_rounded base, fine;
  uint32_t *kept;
  bool has_base; /* false: a first picture */
  uint8_t *bytes;
  size_t size;
};

static const struct lod_mesh *base_of(const struct frame *f) {
  return f->has_base ? &f->base.mesh : NULL;
}

static struct frame encode(const struct lod_mesh *base, const struct lod_mesh *fine, const uint32_t *parents, double step) {
  struct frame f = {.fine = lod_round_mesh(fine, step, arena)};
  struct lod_delta_encode_request request = lod_delta_encode_defaults();
  struct lod_problem problem = {0};
  request.fine = &f.fine.mesh;
  request.grid = f.fine.grid;
  request.to = 3;
  if (base != NULL) {
    f.base = lod_round_mesh(base, 3 * step, arena);
    f.kept = lod_round_kept(&f.base, &f.fine, parents, base->vertex_count, arena);
    f.has_base = true;
    request.base = &f.base.mesh;
    request.kept = f.kept;
    request.from = 2;
  }
  if (lod_delta_encode(&request, arena, &f.bytes, &f.size, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  return f;
}

/* Vertices of `a` to vertices of `b` at the same place; fails the test where there is none. */
static uint32_t *same_places(const struct lod_mesh *a, const struct lod_mesh *b) {
  struct lod_arena *scratch = lod_arena_create(0);
  uint32_t *map = LOD_NEW(arena, a->vertex_count, uint32_t), *welded;
  struct lod_mesh both = {.vertex_count = a->vertex_count + b->vertex_count, .point_count = a->vertex_count + b->vertex_count}, out;
  both.positions = lod_arena_alloc(scratch, both.vertex_count, sizeof *both.positions);
  both.points = LOD_NEW(scratch, both.vertex_count, uint32_t);
  memcpy(both.positions, a->positions, a->vertex_count * sizeof *a->positions);
  memcpy(both.positions + a->vertex_count, b->positions, b->vertex_count * sizeof *b->positions);
  for (uint32_t v = 0; v < both.vertex_count; v++)
    both.points[v] = v;
  assert_int_equal(lod_mesh_weld(&both, scratch, &out, &welded), LOD_OK);
  uint32_t *place = LOD_NEW(scratch, out.vertex_count, uint32_t);
  memset(place, 0xff, out.vertex_count * sizeof *place);
  for (uint32_t v = 0; v < b->vertex_count; v++)
    place[welded[a->vertex_count + v]] = v;
  for (uint32_t v = 0; v < a->vertex_count; v++) {
    map[v] = place[welded[v]];
    assert_int_not_equal(map[v], LOD_NONE);
  }
  lod_arena_destroy(scratch);
  return map;
}

enum { WORDS = 5 + 3 * 8 };

static int compare_words(const void *a, const void *b) {
  return memcmp(a, b, WORDS * sizeof(uint32_t));
}

/* Triangles of `mesh`, in names of `map`, each from its smallest corner on, with part, material, UVs and colours, sorted. */
static uint32_t (*listed(const struct lod_mesh *mesh, const uint32_t *map))[WORDS] {
  uint32_t(*list)[WORDS] = lod_arena_calloc(arena, mesh->triangle_count, sizeof *list);
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    uint32_t v[3];
    int least = 0;
    for (int i = 0; i < 3; i++) {
      v[i] = map == NULL ? mesh->triangles[t][i] : map[mesh->triangles[t][i]];
      if (v[i] < v[least])
        least = i;
    }
    for (int i = 0; i < 3; i++)
      list[t][i] = v[(least + i) % 3];
    list[t][3] = mesh->parts == NULL ? 0 : mesh->parts[t];
    list[t][4] = mesh->materials == NULL ? LOD_NONE : mesh->materials[t];
    for (int i = 0; i < 3 && mesh->wedge_count != 0; i++) {
      uint32_t w = mesh->corners[t][(least + i) % 3], *words = &list[t][5 + 8 * i];
      for (int set = 0; set < LOD_UV_SETS; set++)
        if (mesh->uvs[set] != NULL)
          memcpy(words + 2 * set, mesh->uvs[set][w], 8);
      if (mesh->colors != NULL)
        memcpy(words + 4, mesh->colors[w], 16);
    }
  }
  qsort(list, mesh->triangle_count, sizeof *list, compare_words);
  return list;
}

static void assert_same_mesh(const struct lod_mesh *decoded, const struct lod_mesh *fine) {
  assert_int_equal(decoded->vertex_count, fine->vertex_count);
  assert_int_equal(decoded->triangle_count, fine->triangle_count);
  assert_true(lod_mesh_check(decoded, NULL));
  uint32_t *map = same_places(decoded, fine);
  assert_memory_equal(listed(decoded, map), listed(fine, NULL), fine->triangle_count * sizeof(uint32_t[WORDS]));
}

static struct lod_delta_level decode(const struct frame *f) {
  struct lod_delta_level level;
  struct lod_problem problem = {0};
  /* in memory of exactly this size, so that a sanitizer sees one byte too many */
  uint8_t *copy = malloc(f->size);
  memcpy(copy, f->bytes, f->size);
  if (lod_delta_decode(copy, f->size, base_of(f), NULL, arena, &level, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  free(copy);
  return level;
}

static void assert_round_trip(const struct frame *f) {
  struct lod_delta_level level = decode(f);
  assert_same_mesh(&level.mesh, &f->fine.mesh);
  if (!f->has_base)
    return;
  uint32_t *map = same_places(&level.mesh, &f->fine.mesh);
  for (uint32_t v = 0; v < f->base.mesh.vertex_count; v++)
    if (f->kept[v] == LOD_NONE)
      assert_int_equal(level.kept[v], LOD_NONE);
    else
      assert_int_equal(map[level.kept[v]], f->kept[v]);
}

/* --- shapes --- */

/* Every vertex of the coarser mesh that is at a vertex of the finer one is kept. */
static uint32_t *parents_by_place(const struct lod_mesh *base, const struct lod_mesh *fine) {
  uint32_t *parents = LOD_NEW(arena, base->vertex_count, uint32_t);
  for (uint32_t v = 0; v < base->vertex_count; v++) {
    parents[v] = LOD_NONE;
    for (uint32_t u = 0; u < fine->vertex_count; u++)
      if (memcmp(base->positions[v], fine->positions[u], sizeof *fine->positions) == 0)
        parents[v] = u;
  }
  return parents;
}

static struct frame sphere_step(void) {
  struct lod_mesh base = lod_shape_sphere(arena, 1, 2), fine = lod_shape_sphere(arena, 1, 3);
  return encode(&base, &fine, parents_by_place(&base, &fine), 1e-3);
}

static struct lod_mesh hourglass(void) { /* two cones that share their apex: a vertex with two fans */
  static float positions[][3] = {{0, 0, 0}, {1, 0, 1}, {-1, 1, 1}, {-1, -1, 1}, {1, 0, -1}, {-1, 1, -1}, {-1, -1, -1}};
  static uint32_t triangles[][3] = {{0, 1, 2}, {0, 2, 3}, {0, 3, 1}, {0, 5, 4}, {0, 6, 5}, {0, 4, 6}};
  return (struct lod_mesh){.vertex_count = 7, .triangle_count = 6, .positions = positions, .triangles = triangles};
}

static struct lod_mesh book(void) { /* an edge of four pages, one of them turned over */
  static float positions[][3] = {{0, 0, 0}, {0, 0, 1}, {1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, -1, 0}};
  static uint32_t triangles[][3] = {{0, 1, 2}, {0, 1, 3}, {1, 0, 4}, {0, 1, 5}};
  return (struct lod_mesh){.vertex_count = 6, .triangle_count = 4, .positions = positions, .triangles = triangles};
}

static void first_pictures_come_back_whatever_their_topology(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 2), torus = lod_shape_torus(arena, 2, 0.5, 17, 9);
  struct lod_mesh grid = lod_shape_grid(arena, 1, 9, 0.1), tree = lod_shape_tree(arena, 4, true), cube = lod_shape_cube(arena, 1);
  struct lod_mesh soup = lod_shape_soup(arena, 300, 0.2, 5), none = {0};
  grid.wedge_count = 0; /* positions alone */
  const double offset[3] = {0.5, 0.25, 0.125};
  struct lod_mesh crossing = lod_shape_join(arena, &torus, &torus, offset);
  struct lod_mesh meshes[] = {sphere, torus, grid, tree, cube, soup, none, crossing, hourglass(), book()};
  for (size_t i = 0; i < sizeof meshes / sizeof *meshes; i++) {
    struct frame f = encode(NULL, &meshes[i], NULL, 1e-3);
    assert_round_trip(&f);
  }
}

static void a_step_from_sphere_to_finer_sphere_comes_back(void **state) {
  (void)state;
  struct frame f = sphere_step();
  assert_round_trip(&f);
  assert_true(f.size < 1100); /* 642 vertices, 162 of them kept: 13 bits a vertex */
}

/* Version 2 of the format: whoever changes these bytes must count the version up. */
static void version_3_gives_the_bytes_that_it_gave(void **state) {
  (void)state;
  struct frame step = sphere_step();
  struct lod_mesh soup = lod_shape_soup(arena, 300, 0.2, 5), grid = lod_shape_grid(arena, 1, 16, 0.1);
  struct frame first = encode(NULL, &soup, NULL, 1e-3), attributes = encode(NULL, &grid, NULL, 1e-3);
  assert_int_equal(step.size, 869);
  assert_int_equal(lod_crc32(step.bytes, step.size), 0xca51b737u);
  assert_int_equal(lod_crc32(first.bytes, first.size), 0x75d16142u);
  assert_int_equal(lod_crc32(attributes.bytes, attributes.size), 0x8392edcdu);
}

static void retiled_levels_come_back_one_after_the_other(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 2, 0.7, 60, 30);
  const uint32_t counts[] = {60, 200, 700};
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile retile;
  settings.vertices = counts;
  settings.level_count = 3;
  assert_int_equal(lod_retile_create(&torus, &settings, NULL, arena, &retile, NULL), LOD_OK);
  for (uint32_t k = 0; k < 2; k++) {
    struct frame f = encode(&retile.levels[k].mesh, &retile.levels[k + 1].mesh, retile.levels[k].parents, 1e-3);
    assert_round_trip(&f);
  }
}

static void vertices_of_the_base_may_be_gone_and_parts_may_be_new(void **state) {
  (void)state;
  struct lod_mesh sphere = lod_shape_sphere(arena, 1, 2), finer = lod_shape_sphere(arena, 1, 3),
                  torus = lod_shape_torus(arena, 2, 0.5, 11, 7);
  const double aside[3] = {5, 0, 0};
  struct lod_mesh both = lod_shape_join(arena, &torus, &finer, aside), base = lod_shape_join(arena, &sphere, &sphere, aside);
  uint32_t *parents = parents_by_place(&base, &both); /* the first sphere's vertices are nowhere */
  uint32_t gone = 0;
  for (uint32_t v = 0; v < base.vertex_count; v++)
    gone += parents[v] == LOD_NONE;
  assert_true(gone >= sphere.vertex_count);
  struct frame f = encode(&base, &both, parents, 1e-3);
  assert_round_trip(&f);
}

static void seams_uvs_and_colours_come_back_to_the_bit(void **state) {
  (void)state;
  struct lod_mesh grid = lod_shape_grid(arena, 1, 16, 0.1), coarse = lod_shape_grid(arena, 1, 8, 0.1);
  coarse.wedge_count = 0;
  struct lod_model colored = lod_sample_colored(arena, true), opaque = lod_sample_colored(arena, false),
                   textured = lod_sample_textured(arena);
  struct lod_mesh *seamed = &textured.units[0].mesh;
  struct lod_mesh *cubes[] = {&colored.units[0].mesh, &opaque.units[0].mesh};
  for (int k = 0; k < 2; k++)
    for (uint32_t w = 0; w < cubes[k]->wedge_count; w++)
      for (int i = 0; i < 4; i++)
        cubes[k]->colors[w][i] = (float)((int)(255 * cubes[k]->colors[w][i]) / 255.0);
  for (int set = 0; set < LOD_UV_SETS; set++)
    for (uint32_t w = 0; w < seamed->wedge_count && seamed->uvs[set] != NULL; w++) /* as a level's GLB has them */
      for (int i = 0; i < 2; i++)
        seamed->uvs[set][w][i] = (float)((int)(seamed->uvs[set][w][i] * 4096) / 4096.0);
  assert_true(grid.uvs[0] != NULL && seamed->wedge_count > seamed->vertex_count && seamed->materials != NULL);
  assert_true(colored.units[0].mesh.wedge_count > colored.units[0].mesh.vertex_count);
  struct frame frames[] = {encode(NULL, &grid, NULL, 1e-3), encode(NULL, &colored.units[0].mesh, NULL, 1e-3),
                           encode(NULL, &opaque.units[0].mesh, NULL, 1e-3), encode(NULL, seamed, NULL, 1e-3),
                           encode(&coarse, &grid, parents_by_place(&coarse, &grid), 1e-3)};
  for (size_t i = 0; i < sizeof frames / sizeof *frames; i++)
    assert_round_trip(&frames[i]);
}

/* Largest angle between a decoded corner's normal and the one it was made of, degrees. */
static double worst_angle(const struct frame *f, const struct lod_mesh *decoded) {
  uint32_t *map = same_places(decoded, &f->fine.mesh);
  double least = 1;
  for (uint32_t w = 0; w < decoded->wedge_count; w++) {
    double best = -1; /* smooth meshes and cubes alike: the nearest of the vertex's normals */
    for (uint32_t u = 0; u < f->fine.mesh.wedge_count; u++) {
      const float *a = decoded->normals[w], *b = f->fine.mesh.normals[u];
      double dot = (double)a[0] * b[0] + (double)a[1] * b[1] + (double)a[2] * b[2];
      if (f->fine.mesh.wedge_vertex[u] == map[decoded->wedge_vertex[w]] && dot > best)
        best = dot;
    }
    least = best < least ? best : least;
  }
  return acos(least > 1 ? 1 : least) * 57.29577951308232;
}

static void normals_are_left_out_where_the_surface_has_them_and_sent_where_not(void **state) {
  (void)state;
  struct lod_model smooth = lod_sample_smooth(arena);
  struct lod_mesh turned = smooth.units[0].mesh;
  struct frame plain = encode(NULL, &turned, NULL, 1e-3);
  struct lod_delta_level level = decode(&plain);
  assert_true(worst_angle(&plain, &level.mesh) <= 3);
  turned.normals = lod_arena_copy(arena, turned.normals, turned.wedge_count * sizeof *turned.normals);
  for (uint32_t w = 0; w < turned.wedge_count; w++) { /* a quarter turn about z */
    float x = turned.normals[w][0];
    turned.normals[w][0] = -turned.normals[w][1];
    turned.normals[w][1] = x;
  }
  struct frame sent = encode(NULL, &turned, NULL, 1e-3);
  level = decode(&sent);
  assert_true(worst_angle(&sent, &level.mesh) <= 0.95); /* half a step of 8 bits */
  assert_true(sent.size > plain.size + turned.wedge_count / 2);
}

static void base_may_come_in_any_order(void **state) {
  (void)state;
  struct frame f = sphere_step();
  struct lod_mesh turned = f.base.mesh;
  const uint32_t n = turned.vertex_count;
  turned.positions = lod_arena_alloc(arena, n, sizeof *turned.positions);
  turned.triangles = lod_arena_alloc(arena, turned.triangle_count, sizeof *turned.triangles);
  for (uint32_t v = 0; v < n; v++)
    memcpy(turned.positions[n - 1 - v], f.base.mesh.positions[v], sizeof *turned.positions);
  for (uint32_t t = 0; t < turned.triangle_count; t++)
    for (uint32_t i = 0; i < 3; i++)
      turned.triangles[turned.triangle_count - 1 - t][i] = n - 1 - f.base.mesh.triangles[t][(i + 1) % 3];
  struct lod_delta_level plain = decode(&f), other;
  assert_int_equal(lod_delta_decode(f.bytes, f.size, &turned, NULL, arena, &other, NULL), LOD_OK);
  assert_memory_equal(plain.mesh.positions, other.mesh.positions, plain.mesh.vertex_count * sizeof *plain.mesh.positions);
  assert_memory_equal(plain.mesh.triangles, other.mesh.triangles, plain.mesh.triangle_count * sizeof *plain.mesh.triangles);
  for (uint32_t v = 0; v < n; v++)
    assert_int_equal(plain.kept[v], other.kept[n - 1 - v]);
}

static void decoding_stays_within_the_memory_that_the_header_declares(void **state) {
  (void)state;
  struct lod_mesh big = lod_shape_torus(arena, 2, 0.7, 200, 90), soup = lod_shape_soup(arena, 4000, 0.05, 3);
  struct frame frames[] = {sphere_step(), encode(NULL, &big, NULL, 1e-3), encode(NULL, &soup, NULL, 1e-3),
                           encode(&big, &big, parents_by_place(&big, &big), 1e-3)};
  for (size_t i = 0; i < sizeof frames / sizeof *frames; i++) {
    struct lod_delta_header header;
    struct lod_arena *own = lod_arena_create(0);
    struct lod_delta_level level;
    assert_int_equal(lod_delta_inspect(frames[i].bytes, frames[i].size, &header, NULL), LOD_OK);
    assert_int_equal(header.size, frames[i].size);
    assert_int_equal(lod_delta_decode(frames[i].bytes, frames[i].size, base_of(&frames[i]), NULL, own, &level, NULL), LOD_OK);
    assert_true(lod_arena_peak_bytes(own) <= header.memory_bytes);
    lod_arena_destroy(own);
    struct lod_delta_limits limits = {.max_memory_bytes = header.memory_bytes - 1};
    assert_int_equal(lod_delta_decode(frames[i].bytes, frames[i].size, base_of(&frames[i]), &limits, arena, &level, NULL), LOD_LIMIT);
  }
}

/* --- bad input --- */

static enum lod_status try_bytes(const uint8_t *bytes, size_t size, const struct lod_mesh *base, struct lod_problem *problem) {
  struct lod_arena *own = lod_arena_create(0);
  struct lod_delta_level level;
  uint8_t *copy = malloc(size == 0 ? 1 : size);
  memcpy(copy, bytes, size);
  *problem = (struct lod_problem){0};
  enum lod_status status = lod_delta_decode(copy, size, base, NULL, own, &level, problem);
  if (status == LOD_OK)
    assert_true(lod_mesh_check(&level.mesh, NULL));
  else
    assert_true(problem->status == status && problem->detail[0] != '\0');
  free(copy);
  lod_arena_destroy(own);
  return status;
}

static void every_prefix_fails_with_a_sentence(void **state) {
  (void)state;
  struct frame f = sphere_step();
  for (size_t size = 0; size < f.size; size++) {
    struct lod_problem problem;
    assert_int_equal(try_bytes(f.bytes, size, &f.base.mesh, &problem), LOD_BAD_INPUT);
    assert_string_equal(problem.type, "truncated");
  }
}

static void a_flipped_bit_fails_with_a_sentence(void **state) {
  (void)state;
  struct frame f = sphere_step();
  for (size_t bit = 0; bit < 8 * f.size; bit++) {
    struct lod_problem problem;
    f.bytes[bit / 8] ^= (uint8_t)(1 << bit % 8);
    enum lod_status status = try_bytes(f.bytes, f.size, &f.base.mesh, &problem);
    assert_true(status == LOD_BAD_INPUT || status == LOD_UNSUPPORTED);
    f.bytes[bit / 8] ^= (uint8_t)(1 << bit % 8);
  }
}

static void a_wrong_base_is_refused(void **state) {
  (void)state;
  struct frame f = sphere_step();
  struct lod_problem problem;
  struct lod_mesh other = f.base.mesh;
  assert_int_equal(try_bytes(f.bytes, f.size, NULL, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "wrong-base");
  assert_int_equal(try_bytes(f.bytes, f.size, &f.fine.mesh, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "wrong-base");
  other.positions = lod_arena_copy(arena, other.positions, other.vertex_count * sizeof *other.positions);
  other.positions[7][1] += f.base.grid.step;
  assert_int_equal(try_bytes(f.bytes, f.size, &other, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "wrong-base");
  struct frame first = encode(NULL, &f.fine.mesh, NULL, 1e-3);
  assert_int_equal(try_bytes(first.bytes, first.size, &f.base.mesh, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "wrong-base");
}

static void a_later_version_is_refused(void **state) {
  (void)state;
  struct frame f = sphere_step();
  struct lod_problem problem;
  f.bytes[4] = LOD_DELTA_VERSION + 1;
  assert_int_equal(try_bytes(f.bytes, f.size, &f.base.mesh, &problem), LOD_UNSUPPORTED);
  assert_string_equal(problem.type, "delta-version");
}

static void a_mesh_off_its_grid_is_not_encoded(void **state) {
  (void)state;
  struct frame f = sphere_step();
  struct lod_delta_encode_request request = lod_delta_encode_defaults();
  struct lod_problem problem = {0};
  uint8_t *bytes;
  size_t size;
  request.fine = &f.fine.mesh;
  request.grid = f.fine.grid;
  request.grid.step *= 1.5f;
  assert_int_equal(lod_delta_encode(&request, arena, &bytes, &size, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "off-grid");
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(first_pictures_come_back_whatever_their_topology),
      cmocka_unit_test(a_step_from_sphere_to_finer_sphere_comes_back),
      cmocka_unit_test(version_3_gives_the_bytes_that_it_gave),
      cmocka_unit_test(retiled_levels_come_back_one_after_the_other),
      cmocka_unit_test(vertices_of_the_base_may_be_gone_and_parts_may_be_new),
      cmocka_unit_test(seams_uvs_and_colours_come_back_to_the_bit),
      cmocka_unit_test(normals_are_left_out_where_the_surface_has_them_and_sent_where_not),
      cmocka_unit_test(base_may_come_in_any_order),
      cmocka_unit_test(decoding_stays_within_the_memory_that_the_header_declares),
      cmocka_unit_test(every_prefix_fails_with_a_sentence),
      cmocka_unit_test(a_flipped_bit_fails_with_a_sentence),
      cmocka_unit_test(a_wrong_base_is_refused),
      cmocka_unit_test(a_later_version_is_refused),
      cmocka_unit_test(a_mesh_off_its_grid_is_not_encoded),
  };
  return cmocka_run_group_tests(tests, open_arena, close_arena);
}
