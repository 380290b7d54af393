/* Random polygons on a small lattice, where corners coincide, line up and cross all the time. Whatever comes: the triangles are complete.
 * What brute force calls simple must come back without a flag; what has no flag must cover the polygon with no triangle turned over. */
#include "core/mesh/triangulate.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tests/data/shapes.h"

enum { MOST = 64 };

struct polygon {
  float positions[MOST][3];
  uint32_t loops[MOST], sizes[4], loop_count, corners;
  uint32_t triangles[2 * MOST][3], flags;
  size_t triangle_count;
};

static struct lod_arena *arena;

static int64_t turn(const float *a, const float *b, const float *c) { /* lattice numbers are small: exact */
  return (int64_t)((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]));
}

static bool on_segment(const float *a, const float *b, const float *p) {
  return turn(a, b, p) == 0 && fminf(a[0], b[0]) <= p[0] && p[0] <= fmaxf(a[0], b[0]) && fminf(a[1], b[1]) <= p[1] &&
         p[1] <= fmaxf(a[1], b[1]);
}

static bool touch(const float *a, const float *b, const float *c, const float *d) {
  int64_t abc = turn(a, b, c), abd = turn(a, b, d), cda = turn(c, d, a), cdb = turn(c, d, b);
  if (((abc > 0 && abd < 0) || (abc < 0 && abd > 0)) && ((cda > 0 && cdb < 0) || (cda < 0 && cdb > 0)))
    return true;
  return on_segment(a, b, c) || on_segment(a, b, d) || on_segment(c, d, a) || on_segment(c, d, b);
}

static const float *at(const struct polygon *g, uint32_t corner) {
  return g->positions[g->loops[corner]];
}

/* No two sides meet but neighbours in their common corner, nor do those fold back on each other. */
static bool loops_are_simple(const struct polygon *g) {
  for (uint32_t l = 0, first = 0; l < g->loop_count; first += g->sizes[l++])
    for (uint32_t i = 0; i < g->sizes[l]; i++) {
      uint32_t n = g->sizes[l], a = first + i, b = first + (i + 1) % n, c = first + (i + 2) % n;
      if (on_segment(at(g, a), at(g, b), at(g, c)) || on_segment(at(g, b), at(g, c), at(g, a)))
        return false;
      for (uint32_t m = 0, other = 0; m < g->loop_count; other += g->sizes[m++])
        for (uint32_t j = 0; j < g->sizes[m]; j++) {
          uint32_t p = other + j, q = other + (j + 1) % g->sizes[m];
          if (p != a && p != b && q != a && touch(at(g, a), at(g, b), at(g, p), at(g, q)))
            return false;
        }
    }
  return true;
}

/* Crossing number; p is not on the loop. */
static bool is_inside(const struct polygon *g, uint32_t first, uint32_t count, const float *p) {
  bool inside = false;
  for (uint32_t i = 0; i < count; i++) {
    const float *a = at(g, first + i), *b = at(g, first + (i + 1) % count);
    if ((a[1] > p[1]) != (b[1] > p[1]) && (turn(a, b, p) > 0) == (b[1] > a[1]))
      inside = !inside;
  }
  return inside;
}

static bool holes_are_inside(const struct polygon *g) {
  for (uint32_t l = 1, first = g->sizes[0]; l < g->loop_count; first += g->sizes[l++]) {
    if (!is_inside(g, 0, g->sizes[0], at(g, first)))
      return false;
    for (uint32_t m = 1, other = g->sizes[0]; m < g->loop_count; other += g->sizes[m++])
      if (m != l && is_inside(g, other, g->sizes[m], at(g, first)))
        return false;
  }
  return true;
}

static int64_t loop_area(const struct polygon *g, uint32_t first, uint32_t count) {
  int64_t sum = 0;
  for (uint32_t i = 1; i + 1 < count; i++)
    sum += turn(at(g, first), at(g, first + i), at(g, first + i + 1));
  return sum;
}

static void assert_complete(const struct polygon *g) {
  int uses[MOST][MOST] = {{0}};
  for (size_t t = 0; t < g->triangle_count; t++)
    for (int k = 0; k < 3; k++) {
      assert_true(g->triangles[t][k] < g->corners);
      uses[g->triangles[t][k]][g->triangles[t][(k + 1) % 3]]++;
    }
  for (uint32_t l = 0, first = 0; l < g->loop_count; first += g->sizes[l++])
    for (uint32_t i = 0; i < g->sizes[l] && g->sizes[l] > 2; i++) {
      uint32_t a = first + i, b = first + (i + 1) % g->sizes[l];
      assert_int_equal(abs(uses[a][b] - uses[b][a]), 1);
      uses[a][b] = uses[b][a] = 0;
    }
  for (uint32_t a = 0; a < g->corners; a++)
    for (uint32_t b = 0; b < a; b++)
      assert_int_equal(uses[a][b], uses[b][a]);
}

static void add_loop(struct polygon *g, uint32_t count, uint32_t lattice, uint64_t *seed) {
  for (uint32_t i = 0; i < count; i++, g->corners++) {
    g->positions[g->corners][0] = (float)(lod_random_next(seed) % lattice);
    g->positions[g->corners][1] = (float)(lod_random_next(seed) % lattice);
    g->positions[g->corners][2] = 0;
    g->loops[g->corners] = g->corners;
  }
  g->sizes[g->loop_count++] = count;
}

static void triangulate(struct polygon *g) {
  g->triangle_count = lod_triangulate_count(g->sizes, g->loop_count);
  assert_int_equal(
      lod_triangulate_polygon((const float(*)[3])g->positions, g->loops, g->sizes, g->loop_count, arena, g->triangles, &g->flags), LOD_OK);
  assert_complete(g);
}

static bool check(struct polygon *g) {
  triangulate(g);
  bool simple = loops_are_simple(g) && holes_are_inside(g);
  if (simple)
    assert_int_equal(g->flags, 0);
  if (g->flags != 0)
    return simple;
  int64_t outer = loop_area(g, 0, g->sizes[0]), sum = 0, expected = outer < 0 ? -outer : outer;
  for (uint32_t l = 1, first = g->sizes[0]; l < g->loop_count; first += g->sizes[l++]) {
    int64_t area = loop_area(g, first, g->sizes[l]);
    expected -= area < 0 ? -area : area;
  }
  for (size_t t = 0; t < g->triangle_count; t++) {
    int64_t area = turn(at(g, g->triangles[t][0]), at(g, g->triangles[t][1]), at(g, g->triangles[t][2])) * (outer < 0 ? -1 : 1);
    assert_true(area >= 0);
    if (simple)
      assert_true(area > 0);
    sum += area;
  }
  assert_int_equal(sum, expected);
  return simple;
}

static void every_lattice_polygon_is_complete_and_the_simple_ones_are_covered(void **state) {
  (void)state;
  uint64_t seed = 77;
  int simple = 0;
  for (int trial = 0; trial < 60000; trial++) {
    struct polygon g = {.loop_count = 0};
    add_loop(&g, 3 + (uint32_t)(lod_random_next(&seed) % (trial % 3 == 0 ? 10 : 5)), 3 + (uint32_t)(lod_random_next(&seed) % 8), &seed);
    simple += check(&g);
  }
  assert_true(simple > 5000);
}

static void every_lattice_polygon_with_holes_is_complete_and_the_simple_ones_are_covered(void **state) {
  (void)state;
  uint64_t seed = 78;
  int simple = 0;
  for (int trial = 0; trial < 40000; trial++) {
    struct polygon g = {.loop_count = 0};
    uint32_t holes = 1 + (uint32_t)(lod_random_next(&seed) % 3), lattice = 9;
    if (trial % 2) { /* a frame, so that holes are inside it more often */
      add_loop(&g, 4, lattice, &seed);
      const float frame[4][2] = {{-1, -1}, {9, -1}, {9, 9}, {-1, 9}};
      for (int i = 0; i < 4; i++)
        memcpy(g.positions[i], frame[i], sizeof frame[i]);
    } else {
      add_loop(&g, 3 + (uint32_t)(lod_random_next(&seed) % 6), lattice, &seed);
    }
    for (uint32_t h = 0; h < holes; h++)
      add_loop(&g, trial % 8 < 6 ? 3 : 1 + (uint32_t)(lod_random_next(&seed) % 5), trial % 2 ? lattice : 5, &seed);
    simple += check(&g);
  }
  assert_true(simple > 2000);
}

/* The same in space: no corner at rest, all three views at work; complete whatever comes. */
static void every_polygon_in_space_is_complete(void **state) {
  (void)state;
  uint64_t seed = 79;
  for (int trial = 0; trial < 20000; trial++) {
    struct polygon g = {.loop_count = 0};
    add_loop(&g, 3 + (uint32_t)(lod_random_next(&seed) % 9), 5, &seed);
    if (trial % 4 == 0)
      add_loop(&g, 1 + (uint32_t)(lod_random_next(&seed) % 4), 5, &seed);
    for (uint32_t i = 0; i < g.corners; i++)
      g.positions[i][2] = (float)(lod_random_next(&seed) % 5);
    triangulate(&g);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(every_lattice_polygon_is_complete_and_the_simple_ones_are_covered),
      cmocka_unit_test(every_lattice_polygon_with_holes_is_complete_and_the_simple_ones_are_covered),
      cmocka_unit_test(every_polygon_in_space_is_complete),
  };
  arena = lod_arena_create(0);
  int failed = cmocka_run_group_tests_name("property core/mesh/triangulate", tests, NULL, NULL);
  lod_arena_destroy(arena);
  return failed;
}
