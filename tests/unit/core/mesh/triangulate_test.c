#include "core/mesh/triangulate.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "core/base/predicates.h"
#include "tests/data/shapes.h"

enum { MOST = 4096 };

static struct lod_arena *arena;
static float positions[MOST][3];
static uint32_t loops[MOST], sizes[MOST], loop_count, corner_count, triangles[2 * MOST][3], triangle_count, flags;
static const double kPi = 3.14159265358979323846;

static int open_arena(void **state) {
  (void)state;
  arena = lod_arena_create(0);
  loop_count = corner_count = 0;
  return arena == NULL;
}

static int close_arena(void **state) {
  (void)state;
  lod_arena_destroy(arena);
  return 0;
}

static void begin_loop(void) {
  sizes[loop_count++] = 0;
}

static void corner(double x, double y, double z) {
  assert_true(corner_count < MOST);
  positions[corner_count][0] = (float)x;
  positions[corner_count][1] = (float)y;
  positions[corner_count][2] = (float)z;
  loops[corner_count] = corner_count;
  corner_count++;
  sizes[loop_count - 1]++;
}

static void run(void) {
  size_t before = lod_arena_bytes(arena);
  triangle_count = (uint32_t)lod_triangulate_count(sizes, loop_count);
  memset(triangles, 0xff, sizeof triangles);
  assert_int_equal(lod_triangulate_polygon((const float(*)[3])positions, loops, sizes, loop_count, arena, triangles, &flags), LOD_OK);
  assert_int_equal(lod_arena_bytes(arena), before);
  assert_int_equal(triangles[triangle_count][0], LOD_NONE);
  for (uint32_t t = 0; t < triangle_count; t++)
    for (int k = 0; k < 3; k++)
      assert_true(triangles[t][k] < corner_count);
}

static double area2(uint32_t t) {
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = lod_vec3_from_float(positions[loops[triangles[t][k]]]);
  return lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])).z;
}

static double loop_area2(uint32_t first, uint32_t count) {
  double sum = 0;
  for (uint32_t i = 0; i < count; i++) {
    const float *a = positions[loops[first + i]], *b = positions[loops[first + (i + 1) % count]];
    sum += (double)a[0] * (double)b[1] - (double)a[1] * (double)b[0];
  }
  return sum;
}

/* Twice the area between the outer loop and the holes, in the plane z = const. */
static double polygon_area2(void) {
  double area = 0;
  for (uint32_t l = 0, first = 0; l < loop_count; first += sizes[l++])
    area += (l == 0 ? 1 : -1) * fabs(loop_area2(first, sizes[l]));
  return area;
}

/* Every side of every loop is the side of one triangle, every other side belongs to two that use it both ways. */
static void assert_sides_match(void) {
  static int uses[512][512];
  assert_true(corner_count <= 512);
  memset(uses, 0, sizeof uses);
  for (uint32_t t = 0; t < triangle_count; t++)
    for (int k = 0; k < 3; k++)
      uses[triangles[t][k]][triangles[t][(k + 1) % 3]]++;
  for (uint32_t l = 0, first = 0; l < loop_count; first += sizes[l++])
    for (uint32_t i = 0; i < sizes[l]; i++) {
      uint32_t a = first + i, b = first + (i + 1) % sizes[l];
      assert_int_equal(uses[a][b] + uses[b][a], 1);
      uses[a][b] = uses[b][a] = 0;
    }
  for (uint32_t a = 0; a < corner_count; a++)
    for (uint32_t b = 0; b < a; b++)
      assert_int_equal(uses[a][b], uses[b][a]);
}

/* No flag, no triangle turned over, same area: with the argument in triangulate.c, a cover without overlap. */
static void assert_covers(bool with_area) {
  assert_int_equal(flags, 0);
  double sum = 0, expected = polygon_area2();
  for (uint32_t t = 0; t < triangle_count; t++) {
    double a = area2(t);
    sum += a;
    if (with_area)
      assert_true(a > 0);
    else
      assert_true(a >= 0);
  }
  assert_true(fabs(sum - expected) <= 1e-9 * (1 + fabs(expected)));
  assert_sides_match();
}

static void regular(uint32_t count, double radius, double x, double y, int direction) {
  begin_loop();
  for (uint32_t i = 0; i < count; i++)
    corner(x + radius * cos(direction * 2 * kPi * i / count), y + radius * sin(direction * 2 * kPi * i / count), 0);
}

static void a_triangle_is_itself_and_less_is_nothing(void **state) {
  (void)state;
  regular(3, 1, 0, 0, 1);
  run();
  assert_int_equal(triangle_count, 1);
  assert_covers(true);
  sizes[0] = 2;
  assert_int_equal(lod_triangulate_count(sizes, 1), 0);
  assert_int_equal(lod_triangulate_polygon((const float(*)[3])positions, loops, sizes, 1, arena, triangles, NULL), LOD_OK);
}

static void a_square_and_an_arrowhead_get_the_diagonal_that_stays_inside(void **state) {
  (void)state;
  for (uint32_t turn = 0; turn < 4; turn++) { /* dart with the reflex corner at each place in the order */
    static const double kDart[4][2] = {{0, 0}, {2, -1}, {0.5, 0}, {2, 1}};
    loop_count = corner_count = 0;
    begin_loop();
    for (uint32_t i = 0; i < 4; i++)
      corner(kDart[(i + turn) % 4][0] - 0.0, kDart[(i + turn) % 4][1], 3);
    run();
    assert_int_equal(triangle_count, 2);
    assert_covers(true);
  }
}

static void a_flat_kite_is_cut_along_its_short_diagonal(void **state) {
  (void)state;
  begin_loop();
  corner(-10, 0, 0);
  corner(0, -1, 0);
  corner(10, 0, 0);
  corner(0, 1, 0);
  run();
  assert_covers(true);
  for (int t = 0; t < 2; t++) {
    bool has[4] = {false};
    for (int k = 0; k < 3; k++)
      has[triangles[t][k]] = true;
    assert_true(has[1] && has[3]);
  }
}

static void a_clockwise_polygon_gives_clockwise_triangles(void **state) {
  (void)state;
  regular(9, 1, 0, 0, -1);
  run();
  for (uint32_t t = 0; t < triangle_count; t++)
    assert_true(area2(t) < 0);
}

static void a_vertical_wall_with_a_window_is_seen_from_the_side(void **state) {
  (void)state;
  static const double kWall[2][4][2] = {{{0, 0}, {4, 0}, {4, 3}, {0, 3}}, {{1, 1}, {3, 1}, {3, 2}, {1, 2}}};
  for (int l = 0; l < 2; l++) {
    begin_loop();
    for (int i = 0; i < 4; i++)
      corner(7, kWall[l][i][0], kWall[l][i][1]);
  }
  run();
  assert_int_equal(triangle_count, 8);
  assert_int_equal(flags, 0);
  double area = 0;
  for (uint32_t t = 0; t < 8; t++) {
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = lod_vec3_from_float(positions[triangles[t][k]]);
    double a = lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])).x;
    assert_true(a > 0);
    area += a / 2;
  }
  assert_true(fabs(area - 10) < 1e-12);
  assert_sides_match();
}

static void a_comb_and_a_spiral_are_covered(void **state) {
  (void)state;
  begin_loop();
  for (int i = 0; i < 40; i++) {
    corner(i, 0, 0);
    corner(i + 0.5, 10, 0);
  }
  corner(40, -1, 0);
  corner(0, -1, 0);
  run();
  sizes[0] = corner_count;
  double expected = fabs(polygon_area2()), sum = 0;
  assert_int_equal(flags, 0);
  for (uint32_t t = 0; t < triangle_count; t++) {
    assert_true(area2(t) < 0); /* as listed it turns clockwise */
    sum -= area2(t);
  }
  assert_true(fabs(sum - expected) < 1e-9 * expected);
  loop_count = corner_count = 0;
  begin_loop();
  for (int i = 0; i < 200; i++)
    corner((1 + 0.05 * i) * cos(0.2 * i), (1 + 0.05 * i) * sin(0.2 * i), 0);
  for (int i = 199; i >= 0; i--)
    corner((0.5 + 0.05 * i) * cos(0.2 * i), (0.5 + 0.05 * i) * sin(0.2 * i), 0);
  run();
  assert_int_equal(flags, 0);
  for (uint32_t t = 0; t < triangle_count; t++)
    assert_true(area2(t) != 0 && (area2(t) > 0) == (area2(0) > 0));
  assert_sides_match();
}

static void corners_on_straight_sides_make_no_sliver(void **state) {
  (void)state;
  begin_loop();
  for (int side = 0; side < 4; side++)
    for (int i = 0; i < 8; i++) {
      double along = i - 4, x = side == 0 ? along : side == 1 ? 4 : side == 2 ? -along : -4;
      corner(x, side == 0 ? -4 : side == 1 ? along : side == 2 ? 4 : -along, 0);
    }
  run();
  assert_int_equal(triangle_count, 30);
  assert_covers(true);
}

static void two_holes_that_line_up_with_corners_are_bridged(void **state) {
  (void)state;
  begin_loop();
  corner(0, 0, 0);
  corner(10, 0, 0);
  corner(10, 4, 0);
  corner(0, 4, 0);
  regular(4, 1, 3, 2, 1); /* corners on the line y = 2, both holes and both windings */
  regular(4, 1, 7, 2, -1);
  run();
  assert_int_equal(triangle_count, 14);
  assert_covers(true);
}

static void a_hole_that_touches_the_outer_loop_in_a_corner_is_covered(void **state) {
  (void)state;
  begin_loop();
  corner(0, 0, 0);
  corner(4, 0, 0);
  corner(4, 4, 0);
  corner(0, 4, 0);
  begin_loop();
  corner(4, 4, 0);
  corner(2, 3, 0);
  corner(3, 2, 0);
  run();
  assert_int_equal(triangle_count, 7);
  assert_covers(false);
}

static void doubled_corners_keep_the_count_and_the_area(void **state) {
  (void)state;
  begin_loop();
  for (int i = 0; i < 5; i++)
    for (int twice = 0; twice < 2; twice++)
      corner(cos(2 * kPi * i / 5), sin(2 * kPi * i / 5), 0);
  run();
  assert_int_equal(triangle_count, 8);
  assert_covers(false);
}

static void a_polygon_that_comes_back_to_a_corner_is_covered(void **state) {
  (void)state;
  /* Two squares that meet in a corner, drawn in one stroke without crossing; then a square with a slit to its middle. */
  static const double kTwo[8][2] = {{0, 0}, {1, -1}, {2, 0}, {1, 1}, {0, 0}, {-1, 1}, {-2, 0}, {-1, -1}};
  static const double kSlit[7][2] = {{-1, -1}, {1, -1}, {1, 1}, {0, 1}, {0, 0}, {0, 1}, {-1, 1}};
  begin_loop();
  for (int i = 0; i < 8; i++)
    corner(kTwo[i][0], kTwo[i][1], 0);
  run();
  assert_covers(false);
  loop_count = corner_count = 0;
  begin_loop();
  for (int i = 0; i < 7; i++)
    corner(kSlit[i][0], kSlit[i][1], 0);
  run();
  assert_covers(false);
}

static void a_figure_of_eight_is_flagged_and_complete(void **state) {
  (void)state;
  static const double kEight[6][2] = {{-2, -1}, {2, 1}, {3, 0}, {2, -1}, {-2, 1}, {-3, 0}};
  begin_loop();
  for (int i = 0; i < 6; i++)
    corner(kEight[i][0], kEight[i][1], 0);
  run();
  assert_int_equal(triangle_count, 4);
  assert_int_equal(flags, LOD_TRIANGULATE_CROSSED);
  assert_sides_match();
  loop_count = corner_count = 0;
  begin_loop(); /* the crossed quad */
  corner(0, 0, 0);
  corner(1, 1, 0);
  corner(1, 0, 0);
  corner(0, 1, 0);
  run();
  assert_int_equal(flags, LOD_TRIANGULATE_CROSSED);
  assert_sides_match();
  loop_count = corner_count = 0;
  begin_loop(); /* a long one, beyond the least-area search */
  for (int i = 0; i < 301; i++)
    corner(sin(4 * kPi * i / 301), sin(2 * kPi * i / 301), 0);
  run();
  assert_int_equal(flags, LOD_TRIANGULATE_CROSSED);
  assert_sides_match();
}

static void a_hole_outside_the_outer_loop_is_flagged_and_complete(void **state) {
  (void)state;
  regular(5, 1, 0, 0, 1);
  regular(4, 1, 5, 0, 1);
  run();
  assert_int_equal(triangle_count, 9);
  assert_int_equal(flags, LOD_TRIANGULATE_CROSSED);
}

static void corners_on_a_line_or_a_point_are_degenerate(void **state) {
  (void)state;
  begin_loop();
  for (int i = 0; i < 6; i++)
    corner(i, 2 * i, -3 * i);
  run();
  assert_int_equal(flags, LOD_TRIANGULATE_DEGENERATE);
  assert_sides_match();
  for (uint32_t i = 0; i < corner_count; i++)
    memset(positions[i], 0, sizeof positions[i]);
  run();
  assert_int_equal(flags, LOD_TRIANGULATE_DEGENERATE);
  sizes[0] = corner_count = 4;
  run();
  assert_int_equal(flags, LOD_TRIANGULATE_DEGENERATE);
}

static void a_saddle_is_covered_in_the_view_from_above(void **state) {
  (void)state;
  begin_loop();
  for (int i = 0; i < 24; i++)
    corner(cos(2 * kPi * i / 24), sin(2 * kPi * i / 24), 0.3 * cos(4 * kPi * i / 24));
  run();
  assert_covers(true);
}

static void corners_share_vertices_through_the_index(void **state) {
  (void)state;
  regular(8, 1, 0, 0, 1);
  for (uint32_t i = 0; i < 8; i++)
    loops[i] = 7 - i; /* the other way round: clockwise */
  run();
  for (uint32_t t = 0; t < triangle_count; t++)
    assert_true(area2(t) < 0);
  assert_sides_match();
}

/* Star-shaped outer loops with star-shaped holes on a grid inside, tilted into space: the count, no overlap, every side used. */
static void random_stars_with_holes_are_covered(void **state) {
  (void)state;
  uint64_t seed = 11;
  for (int trial = 0; trial < 400; trial++) {
    loop_count = corner_count = 0;
    uint32_t outer = 3 + (uint32_t)(lod_random_next(&seed) % 60), holes = 0;
    bool lattice = trial % 4 == 0; /* corners on coarse numbers: collinear and equal coordinates abound */
    begin_loop();
    for (uint32_t i = 0; i < outer; i++) {
      double r = lattice ? 20 : 14 + 10 * lod_random_unit(&seed), a = 2 * kPi * (i + 0.8 * lod_random_unit(&seed)) / outer;
      corner(outer < 8 ? 50 * cos(2 * kPi * i / outer) : r * cos(a), outer < 8 ? 50 * sin(2 * kPi * i / outer) : r * sin(a), 0);
    }
    for (int gx = -3; gx <= 3; gx++)
      for (int gy = -3; gy <= 3; gy++) {
        if (outer < 16 || lod_random_unit(&seed) < 0.6)
          continue;
        uint32_t count = lattice ? 4 : 1 + (uint32_t)(lod_random_next(&seed) % 9);
        begin_loop();
        holes++;
        for (uint32_t i = 0; i < count; i++) {
          double r = lattice ? 1 : 0.2 + lod_random_unit(&seed),
                 a = (trial & 1 ? -2 : 2) * kPi * (i + (lattice ? 0 : 0.8 * lod_random_unit(&seed))) / count;
          corner(2.5 * gx + (lattice ? round(r * cos(a)) : r * cos(a)), 2.5 * gy + (lattice ? round(r * sin(a)) : r * sin(a)), 0);
        }
      }
    run();
    assert_int_equal(triangle_count, corner_count + 2 * holes - 2);
    bool slits = false;
    for (uint32_t l = 1; l < loop_count; l++)
      slits |= sizes[l] < 3;
    if (!slits) {
      assert_covers(true);
    } else {
      assert_int_equal(flags, 0);
    }
  }
}

static void a_hundred_thousand_corners_take_no_quadratic_time(void **state) {
  (void)state;
  enum { N = 100000 };
  float(*many)[3] = lod_arena_alloc(arena, N, sizeof *many);
  uint32_t *index = LOD_NEW(arena, N, uint32_t), size = N;
  uint32_t(*out)[3] = lod_arena_alloc(arena, N, sizeof *out);
  uint64_t seed = 3;
  for (uint32_t i = 0; i < N; i++) {
    double r = 1 + 0.5 * lod_random_unit(&seed), a = 2 * kPi * i / N;
    many[i][0] = (float)(r * cos(a));
    many[i][1] = (float)(r * sin(a));
    many[i][2] = 0;
    index[i] = i;
  }
  assert_int_equal(lod_triangulate_polygon((const float(*)[3])many, index, &size, 1, arena, out, &flags), LOD_OK);
  assert_int_equal(flags, 0);
  double sum = 0, expected = 0;
  for (uint32_t t = 0; t + 2 < N; t++) {
    double p[3][2];
    for (int k = 0; k < 3; k++)
      for (int d = 0; d < 2; d++)
        p[k][d] = (double)many[out[t][k]][d];
    assert_true(lod_orient2d(p[0], p[1], p[2]) >= 0);
    sum += (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0]);
  }
  for (uint32_t i = 0; i < N; i++) {
    const float *a = many[i], *b = many[(i + 1) % N];
    expected += (double)a[0] * (double)b[1] - (double)a[1] * (double)b[0];
  }
  assert_true(fabs(sum - expected) < 1e-9);
}

static void a_small_memory_limit_says_memory(void **state) {
  (void)state;
  regular(2000, 1, 0, 0, 1);
  struct lod_arena *small = lod_arena_create(100000);
  assert_int_equal(lod_triangulate_polygon((const float(*)[3])positions, loops, sizes, 1, small, triangles, NULL), LOD_MEMORY);
  lod_arena_destroy(small);
}

int main(void) {
#define CLAIM(name) cmocka_unit_test_setup_teardown(name, open_arena, close_arena)
  const struct CMUnitTest tests[] = {
      CLAIM(a_triangle_is_itself_and_less_is_nothing),
      CLAIM(a_square_and_an_arrowhead_get_the_diagonal_that_stays_inside),
      CLAIM(a_flat_kite_is_cut_along_its_short_diagonal),
      CLAIM(a_clockwise_polygon_gives_clockwise_triangles),
      CLAIM(a_vertical_wall_with_a_window_is_seen_from_the_side),
      CLAIM(a_comb_and_a_spiral_are_covered),
      CLAIM(corners_on_straight_sides_make_no_sliver),
      CLAIM(two_holes_that_line_up_with_corners_are_bridged),
      CLAIM(a_hole_that_touches_the_outer_loop_in_a_corner_is_covered),
      CLAIM(doubled_corners_keep_the_count_and_the_area),
      CLAIM(a_polygon_that_comes_back_to_a_corner_is_covered),
      CLAIM(a_figure_of_eight_is_flagged_and_complete),
      CLAIM(a_hole_outside_the_outer_loop_is_flagged_and_complete),
      CLAIM(corners_on_a_line_or_a_point_are_degenerate),
      CLAIM(a_saddle_is_covered_in_the_view_from_above),
      CLAIM(corners_share_vertices_through_the_index),
      CLAIM(random_stars_with_holes_are_covered),
      CLAIM(a_hundred_thousand_corners_take_no_quadratic_time),
      CLAIM(a_small_memory_limit_says_memory),
  };
  return cmocka_run_group_tests_name("core/mesh/triangulate", tests, NULL, NULL);
}
