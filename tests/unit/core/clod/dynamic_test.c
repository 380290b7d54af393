/* Tessellation that follows a view (P3-23), and strictly smooth patches (P3-27). */
#include "core/clod/dynamic.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

#include "core/clod/clod.h"
#include "core/clod/halve.h"
#include "core/mesh/topology.h"
#include "tests/data/arena.h"
#include "tests/data/shapes.h"

static uint64_t seed = 11;

static struct lod_patches clod_of(const struct lod_mesh *mesh, uint32_t wanted) {
  struct lod_clod *clod;
  struct lod_clod_facts facts;
  struct lod_patches patches;
  assert_int_equal(lod_clod_create(mesh, NULL, arena, &clod, NULL), LOD_OK);
  assert_int_equal(lod_clod_simplify(clod, wanted, INFINITY, NULL), LOD_OK);
  lod_clod_facts(clod, &facts);
  assert_int_equal(lod_clod_extract(clod, facts.clod, arena, &patches, NULL), LOD_OK);
  return patches;
}

static struct lod_patches shape(int which) {
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 40, 20), grid = lod_shape_grid(arena, 2, 16, 0.3),
                  tube = lod_shape_tube(arena, 0.5, 3, 24, 12);
  return which == 0 ? clod_of(&torus, 120) : which == 1 ? clod_of(&grid, 60) : clod_of(&tube, 100);
}

static double random_in(double a, double b) {
  return a + (b - a) * lod_random_unit(&seed);
}

static struct lod_dynamic_view view_from(struct lod_vec3 eye, struct lod_vec3 target) {
  struct lod_vec3 forward = lod_vec3_normalize(lod_vec3_subtract(target, eye)), side = {0.1, 0.9, 0.3};
  struct lod_vec3 right = lod_vec3_normalize(lod_vec3_cross(forward, side));
  return (struct lod_dynamic_view){.eye = eye,
                                   .forward = forward,
                                   .up = lod_vec3_cross(right, forward),
                                   .fov_degrees = 45,
                                   .aspect = 1.5,
                                   .height_px = 600,
                                   .near = 0.001};
}

static struct lod_dynamic_view random_view(double nearest, double farthest) {
  struct lod_vec3 d = lod_vec3_normalize((struct lod_vec3){random_in(-1, 1), random_in(-1, 1), random_in(-1, 1)});
  struct lod_vec3 target = {random_in(-0.5, 0.5), random_in(-0.5, 0.5), random_in(-0.2, 0.2)};
  return view_from(lod_vec3_scale(d, random_in(nearest, farthest)), target);
}

static struct lod_dynamic *open_dynamic(const struct lod_patches *patches) {
  struct lod_dynamic *dynamic;
  assert_int_equal(lod_dynamic_create(patches, arena, &dynamic), LOD_OK);
  return dynamic;
}

static struct lod_dynamic_stats update(struct lod_dynamic *dynamic, const struct lod_dynamic_view *view,
                                       const struct lod_dynamic_settings *settings) {
  struct lod_dynamic_stats stats;
  assert_int_equal(lod_dynamic_update(dynamic, view, settings, &stats), LOD_OK);
  return stats;
}

/* Pixels; false when the point is not in the window in front of `near`. */
static bool picture(const struct lod_dynamic_view *view, struct lod_vec3 p, double at[2]) {
  struct lod_vec3 to = lod_vec3_subtract(p, view->eye), right = lod_vec3_cross(view->forward, view->up);
  double depth = lod_vec3_dot(to, view->forward), half = tan(view->fov_degrees * acos(-1) / 360), focal = view->height_px / (2 * half);
  if (!(depth > view->near))
    return false;
  at[0] = focal * lod_vec3_dot(to, right) / depth;
  at[1] = focal * lod_vec3_dot(to, view->up) / depth;
  return fabs(at[0]) <= view->aspect * view->height_px / 2 && fabs(at[1]) <= view->height_px / 2;
}

/* Farthest, in pixels, that a point of a drawn triangle is from the surface's point that it stands for. */
static double worst_pixels(const struct lod_dynamic *dynamic, const struct lod_dynamic_view *view) {
  struct lod_dynamic_mesh mesh;
  const struct lod_patches *surface = lod_dynamic_surface(dynamic, NULL, NULL);
  lod_dynamic_mesh(dynamic, &mesh);
  double worst = 0;
  uint32_t next = 0;
  for (uint32_t p = 0; p < surface->patch_count; p++) {
    const uint32_t(*triangles)[3];
    const struct lod_barycentric *domain;
    uint32_t count = lod_dynamic_domain(dynamic, p, &triangles, &domain);
    struct lod_bezier net = lod_patches_net(surface, p);
    for (uint32_t t = 0; t < count; t++, next += 3)
      for (int s = 0; s < 6; s++) {
        double v = random_in(0, 1), w = random_in(0, 1), l[3];
        l[1] = v + w > 1 ? 1 - v : v, l[2] = v + w > 1 ? 1 - w : w, l[0] = 1 - l[1] - l[2];
        struct lod_barycentric at = {0, 0, 0};
        struct lod_vec3 q = {0, 0, 0};
        for (int k = 0; k < 3; k++) {
          struct lod_barycentric corner = domain[triangles[t][k]];
          at = (struct lod_barycentric){at.u + l[k] * corner.u, at.v + l[k] * corner.v, at.w + l[k] * corner.w};
          q = lod_vec3_add_scaled(q, lod_vec3_from_float(mesh.positions[mesh.indices[next + (uint32_t)k]]), l[k]);
        }
        double a[2], b[2];
        if (picture(view, q, a) && picture(view, lod_bezier_point(&net, at), b))
          worst = fmax(worst, hypot(a[0] - b[0], a[1] - b[1]));
      }
  }
  assert_int_equal(next, mesh.index_count);
  return worst;
}

static void what_is_drawn_is_within_the_tolerance_in_pixels(void **state) {
  (void)state;
  double slack = 0;
  int views = 0;
  for (int which = 0; which < 3; which++) {
    struct lod_patches patches = shape(which);
    struct lod_dynamic *dynamic = open_dynamic(&patches);
    for (int round = 0; round < 40; round++) {
      struct lod_dynamic_settings settings = lod_dynamic_defaults();
      settings.pixels = round % 4 == 0 ? 4 : round % 4 == 1 ? 0.25 : 1;
      struct lod_dynamic_view view = random_view(round % 5 == 0 ? 0.3 : 1.5, 8);
      struct lod_dynamic_stats stats = update(dynamic, &view, &settings);
      double worst = worst_pixels(dynamic, &view);
      assert_true(stats.pixels <= settings.pixels && worst <= settings.pixels);
      assert_true(worst <= stats.pixels + 0.01);
      if (worst > 0) {
        slack += settings.pixels / worst;
        views++;
      }
    }
    lod_dynamic_destroy(dynamic);
  }
  print_message("mean slack of the worst triangle %.2f\n", slack / views);
  assert_true(slack / views < 4);
}

/* All indices of a closed surface: every edge has two triangles, however the view has cut it. */
static void no_view_opens_a_crack(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 40, 20), cube = lod_shape_cube(arena, 1);
  const struct lod_patches both[2] = {clod_of(&torus, 80), clod_of(&cube, 12)};
  for (int which = 0; which < 2; which++) {
    struct lod_dynamic *dynamic = open_dynamic(&both[which]);
    struct lod_dynamic_settings settings = lod_dynamic_defaults();
    settings.cull_back = settings.cull_outside = false;
    for (int round = 0; round < 30; round++) {
      settings.pixels = random_in(0.2, 6);
      struct lod_dynamic_view view = random_view(1.2, 5);
      struct lod_dynamic_stats stats = update(dynamic, &view, &settings);
      struct lod_dynamic_mesh drawn;
      lod_dynamic_mesh(dynamic, &drawn);
      struct lod_arena *scratch = lod_arena_create(0);
      struct lod_mesh mesh = {.vertex_count = drawn.vertex_room, .triangle_count = stats.triangles}, welded;
      mesh.positions = lod_arena_alloc(scratch, drawn.vertex_room, sizeof *mesh.positions);
      mesh.triangles = lod_arena_alloc(scratch, stats.triangles, sizeof *mesh.triangles);
      memset(mesh.positions, 0, drawn.vertex_room * sizeof *mesh.positions);
      for (uint32_t i = 0; i < drawn.index_count; i++)
        memcpy(mesh.positions[drawn.indices[i]], drawn.positions[drawn.indices[i]], sizeof *mesh.positions);
      memcpy(mesh.triangles, drawn.indices, drawn.index_count * sizeof *drawn.indices);
      assert_int_equal(lod_mesh_weld(&mesh, scratch, &welded, NULL), LOD_OK);
      struct lod_topology topology;
      assert_int_equal(lod_topology_measure(&welded, NULL, scratch, &topology), LOD_OK);
      assert_true(topology.closed && topology.manifold && topology.oriented);
      assert_int_equal(topology.genus, which == 0);
      lod_arena_destroy(scratch);
    }
    lod_dynamic_destroy(dynamic);
  }
}

static void what_is_left_out_cannot_be_seen(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 40, 20);
  struct lod_patches patches = clod_of(&torus, 200);
  struct lod_dynamic *dynamic = open_dynamic(&patches);
  struct lod_dynamic_settings settings = lod_dynamic_defaults();
  uint32_t backs = 0, outsides = 0, all_back = 0;
  for (int round = 0; round < 60; round++) {
    struct lod_dynamic_view view = random_view(0.8, 6);
    update(dynamic, &view, &settings);
    const uint8_t *visible;
    const struct lod_patches *surface = lod_dynamic_surface(dynamic, &visible, NULL);
    for (uint32_t p = 0; p < surface->patch_count; p++) {
      struct lod_bezier net = lod_patches_net(surface, p);
      bool in_window = false, front = false;
      for (int i = 0; i <= 12; i++)
        for (int j = 0; i + j <= 12; j++) {
          struct lod_barycentric at = {(12 - i - j) / 12.0, i / 12.0, j / 12.0};
          struct lod_vec3 q = lod_bezier_point(&net, at);
          double x[2];
          in_window = picture(&view, q, x) || in_window;
          front = lod_vec3_dot(lod_bezier_normal(&net, at), lod_vec3_subtract(view.eye, q)) > 0 || front;
        }
      if (visible[p] == 2) {
        assert_false(in_window);
        outsides++;
      } else if (visible[p] == 3) {
        assert_false(front);
        backs++;
      }
      all_back += !front;
    }
  }
  assert_true(backs > all_back / 2 && outsides > 500);
  lod_dynamic_destroy(dynamic);
  /* A surface with a border is seen from behind. */
  struct lod_patches open = shape(1);
  dynamic = open_dynamic(&open);
  for (int round = 0; round < 20; round++) {
    struct lod_dynamic_view view = random_view(2, 6);
    assert_int_equal(update(dynamic, &view, &settings).back, 0);
  }
  lod_dynamic_destroy(dynamic);
}

static void only_what_the_view_asks_for_is_made_anew(void **state) {
  (void)state;
  struct lod_patches patches = shape(0);
  struct lod_dynamic *dynamic = open_dynamic(&patches);
  struct lod_dynamic_settings settings = lod_dynamic_defaults();
  struct lod_dynamic_view view = view_from((struct lod_vec3){3, 1, 1}, (struct lod_vec3){0, 0, 0});
  struct lod_dynamic_stats first = update(dynamic, &view, &settings), stats = update(dynamic, &view, &settings);
  struct lod_dynamic_mesh mesh;
  assert_true(first.patches_made >= first.visible && first.vertices_made > 0);
  assert_int_equal(stats.patches_made + stats.edges_made, 0);
  lod_dynamic_mesh(dynamic, &mesh);
  assert_int_equal(mesh.changed_count, 0);
  uint32_t made = 0, visible = 0;
  for (int step = 0; step < 100; step++) { /* towards the surface, at three hundredths of the way a second */
    view.eye = lod_vec3_scale(view.eye, 0.995);
    stats = update(dynamic, &view, &settings);
    made += stats.patches_made;
    visible += stats.visible;
  }
  assert_true(made > 0 && made < visible / 5);
  lod_dynamic_destroy(dynamic);
}

/* So near that a patch of 64 parts shows its corners: the surface is halved, the tolerance held, and given up again farther away. */
static void there_are_no_facets_at_any_zoom(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 40, 20);
  struct lod_patches patches = clod_of(&torus, 40);
  struct lod_dynamic *dynamic = open_dynamic(&patches);
  struct lod_dynamic_settings settings = lod_dynamic_defaults();
  struct lod_dynamic_view far = view_from((struct lod_vec3){4, 0.1, 0.2}, (struct lod_vec3){0, 0, 0});
  bool halved = false;
  for (double distance = 1; distance > 1e-3; distance /= 3) {
    struct lod_dynamic_view view = view_from((struct lod_vec3){1.4 + distance, 0.01, 0.02}, (struct lod_vec3){1.4, 0, 0});
    view.near = distance / 100;
    settings.pixels = 0.3;
    struct lod_dynamic_stats stats = update(dynamic, &view, &settings);
    halved = halved || stats.halved;
    assert_true(stats.visible > 0 && stats.triangles > 0 && stats.triangles < 600000);
    assert_true(stats.pixels <= 0.3);
    assert_true(lod_patches_check(lod_dynamic_surface(dynamic, NULL, NULL), NULL));
    if (distance > 0.01) /* below, float coordinates are worth a share of a pixel */
      assert_true(worst_pixels(dynamic, &view) <= 0.3);
  }
  assert_true(halved);
  settings.pixels = 4;
  assert_int_equal(update(dynamic, &far, &settings).patches, patches.patch_count);
  lod_dynamic_destroy(dynamic);
}

static void halving_leaves_the_surface_and_opens_no_crack(void **state) {
  (void)state;
  struct lod_mesh torus = lod_shape_torus(arena, 1, 0.4, 40, 20);
  struct lod_patches patches = clod_of(&torus, 60), before = patches;
  uint32_t *roots = NULL;
  for (int round = 0; round < 3; round++) {
    bool *marks = LOD_NEW_ZERO(arena, before.edge_count, bool);
    for (uint32_t e = 0; e < before.edge_count; e++)
      marks[e] = lod_random_unit(&seed) < 0.4;
    struct lod_patches after;
    uint32_t *next;
    assert_int_equal(lod_patches_halve(&before, marks, roots, arena, &after, &next), LOD_OK);
    assert_true(lod_patches_check(&after, NULL));
    assert_true(after.patch_count > before.patch_count);
    for (uint32_t e = 0; e < after.edge_count; e++) { /* two patches have the edge's curve, which is their common border */
      assert_true(after.ends[e][0] != after.ends[e][1]);
    }
    for (uint32_t p = 0; p < after.patch_count; p++)
      for (uint32_t k = 0; k < 3; k++)
        assert_true(after.partners[p][k] != LOD_NONE);
    before = after;
    roots = next;
  }
  /* Every new patch lies on the patch it came from. */
  for (uint32_t p = 0; p < before.patch_count; p++) {
    struct lod_bezier part = lod_patches_net(&before, p), whole = lod_patches_net(&patches, roots[p]);
    struct lod_vec3 q = lod_bezier_point(&part, (struct lod_barycentric){0.3, 0.3, 0.4});
    double nearest = INFINITY;
    for (int i = 0; i <= 100; i++)
      for (int j = 0; i + j <= 100; j++) {
        struct lod_barycentric at = {(100 - i - j) / 100.0, i / 100.0, j / 100.0};
        nearest = fmin(nearest, lod_vec3_distance(lod_bezier_point(&whole, at), q));
      }
    assert_true(nearest < 0.02);
  }
}

static struct lod_bezier random_patch(double wild) {
  struct lod_bezier patch = lod_bezier_flat((struct lod_vec3){0, 0, 0}, (struct lod_vec3){1, 0, 0}, (struct lod_vec3){0, 1, 0});
  for (int i = 0; i < LOD_BEZIER_POINTS; i++)
    patch.p[i] = lod_vec3_add_scaled(patch.p[i], (struct lod_vec3){random_in(-1, 1), random_in(-1, 1), random_in(-1, 1)}, wild);
  return patch;
}

static void the_cone_holds_all_normals(void **state) {
  (void)state;
  int found = 0;
  for (int round = 0; round < 300; round++) {
    struct lod_bezier patch = random_patch(0.12);
    struct lod_vec3 axis;
    double sine;
    if (!lod_bezier_normal_cone(&patch, &axis, &sine))
      continue;
    found++;
    double least = sqrt(1 - sine * sine);
    for (int i = 0; i <= 16; i++)
      for (int j = 0; i + j <= 16; j++) {
        struct lod_barycentric at = {(16 - i - j) / 16.0, i / 16.0, j / 16.0};
        assert_true(lod_vec3_dot(lod_bezier_normal(&patch, at), axis) >= least - 1e-9);
      }
  }
  assert_true(found > 100);
}

/* Regular patches turn nowhere by more than a little from one sample to the next; folded ones are never called regular. */
static void folds_are_never_called_regular(void **state) {
  (void)state;
  int found = 0, beyond_cone = 0, turned = 0;
  for (int round = 0; round < 400; round++) {
    struct lod_bezier patch = random_patch(round % 2 == 0 ? 0.15 : 0.5);
    bool regular = lod_bezier_is_regular(&patch), turns = false;
    struct lod_vec3 axis, before = {0, 0, 0};
    double sine;
    for (int i = 0; i <= 32; i++)
      for (int j = 0; i + j <= 32; j++) {
        struct lod_barycentric at = {(32 - i - j) / 32.0, i / 32.0, j / 32.0};
        struct lod_vec3 dv, dw, normal;
        lod_bezier_derivatives(&patch, at, &dv, &dw);
        normal = lod_vec3_cross(dv, dw);
        /* Along a row the normal is continuous: where it jumps over a right angle it was near zero, which a cone of a part excludes. */
        turns = turns || (j > 0 && lod_vec3_dot(normal, before) < -0.9 * lod_vec3_length(normal) * lod_vec3_length(before));
        before = normal;
      }
    found += regular;
    turned += turns;
    beyond_cone += regular && !lod_bezier_normal_cone(&patch, &axis, &sine);
    assert_false(regular && turns);
    assert_true(regular || !lod_bezier_normal_cone(&patch, &axis, &sine));
  }
  assert_true(found > 100 && beyond_cone > 10 && turned > 10);
}

/* The same points four at a time, and one by one. */
static void grids_are_evaluated_within_their_rounding(void **state) {
  (void)state;
  struct lod_pattern_cache cache;
  assert_int_equal(lod_pattern_cache_init(&cache, arena), LOD_OK);
  for (uint32_t m = 3; m <= LOD_TESSELLATE_MOST; m += 1 + m / 5) {
    struct lod_bezier net = random_patch(0.3);
    for (int i = 0; i < LOD_BEZIER_POINTS; i++)
      net.p[i].x += 1000; /* far away: the patch's own size counts */
    uint32_t found, factors[3] = {m, 2, 5};
    assert_int_equal(lod_pattern_cache_find(&cache, m, factors, &found), LOD_OK);
    const struct lod_tessellation_pattern *pattern = &cache.entries[found].pattern;
    uint32_t count = pattern->vertex_count - pattern->inner_vertices;
    float(*positions)[3] = lod_arena_alloc(arena, count, sizeof *positions), (*normals)[3] = lod_arena_alloc(arena, count, sizeof *normals);
    struct lod_evaluator evaluator;
    lod_evaluator_init(&evaluator, &net);
    lod_evaluate_grid(&evaluator, &cache.grids[m], count, positions, normals);
    for (uint32_t v = 0; v < count; v++) {
      struct lod_barycentric at = pattern->domain[pattern->inner_vertices + v];
      struct lod_vec3 exact = lod_bezier_point(&net, at), n = lod_vec3_from_float(normals[v]);
      assert_true(lod_vec3_distance(exact, lod_vec3_from_float(positions[v])) <= evaluator.rounding + 0x1p-24 * 2 * 1001);
      if (lod_vec3_length_squared(n) > 0.5)
        assert_true(lod_vec3_dot(n, lod_bezier_normal(&net, at)) > 0.99999);
    }
  }
}

/* P3-27: one tangent plane along every edge, by the same vertices, normals and curves; and its distance from the cubics is bounded. */
static void strict_patches_have_one_tangent_plane_along_edges(void **state) {
  (void)state;
  for (int which = 0; which < 3; which++) {
    struct lod_patches coarse = shape(which), patches;
    double plain = 1, strict = 1, apart = 0, most;
    assert_int_equal(lod_patches_make_strict(&coarse, arena, &patches, &most), LOD_OK);
    assert_true(lod_patches_check(&patches, NULL));
    for (uint32_t p = 0; p < patches.patch_count; p++) {
      struct lod_gregory g;
      struct lod_bezier net = lod_patches_net(&patches, p), old = lod_patches_net(&coarse, p);
      lod_gregory_make(&patches, p, &g);
      for (int i = 0; i <= 10; i++)
        for (int j = 0; i + j <= 10; j++) {
          struct lod_barycentric at = {(10 - i - j) / 10.0, i / 10.0, j / 10.0};
          double distance = lod_vec3_distance(lod_gregory_point(&g, at, NULL), lod_bezier_point(&net, at));
          assert_true(distance <= g.deviation + 1e-12);
          distance = lod_vec3_distance(lod_gregory_point(&g, at, NULL), lod_bezier_point(&old, at));
          assert_true(distance <= most + 1e-12);
          apart = fmax(apart, distance);
        }
      for (uint32_t k = 0; k < 3; k++) {
        uint32_t other = patches.partners[p][k], side = patches.edges[p][k];
        if (other == LOD_NONE || patches.sharp[side >> 1])
          continue;
        for (int i = 0; i <= 8; i++) {
          double t = i / 8.0;
          struct lod_vec3 a[2], b[2];
          for (int s = 0; s < 2; s++) {
            enum lod_smoothness smoothness = s == 0 ? LOD_SMOOTH_SHADED : LOD_SMOOTH_STRICT;
            const struct lod_patches *of = s == 0 ? &coarse : &patches;
            a[s] = lod_edge_normal(of, 3 * p + k, side & 1, t, smoothness);
            b[s] = lod_edge_normal(of, other, (side & 1) == 0, t, smoothness);
          }
          plain = fmin(plain, lod_vec3_dot(a[0], b[0]));
          strict = fmin(strict, lod_vec3_dot(a[1], b[1]));
        }
      }
    }
    print_message("largest gap %.3f degrees plain, %.6f strict; %.2g apart, bound %.2g\n", acos(plain) * 57.2958,
                  acos(fmin(1, strict)) * 57.2958, apart, most);
    assert_true(acos(fmin(1, strict)) * 57.2958 < 1e-3 && apart > 0);
  }
}

static void strict_patches_are_drawn_and_stay_closed(void **state) {
  (void)state;
  struct lod_patches patches = shape(0);
  struct lod_dynamic *dynamic = open_dynamic(&patches);
  struct lod_dynamic_settings settings = lod_dynamic_defaults();
  struct lod_dynamic_view view = view_from((struct lod_vec3){3, 1, 1}, (struct lod_vec3){0, 0, 0});
  struct lod_dynamic_stats plain = update(dynamic, &view, &settings);
  settings.smoothness = LOD_SMOOTH_STRICT;
  struct lod_dynamic_stats strict = update(dynamic, &view, &settings);
  struct lod_dynamic_mesh mesh;
  lod_dynamic_mesh(dynamic, &mesh);
  assert_int_equal(plain.triangles, strict.triangles);
  assert_true(strict.patches_made >= strict.visible);
  for (uint32_t i = 0; i < mesh.index_count; i++) {
    struct lod_vec3 n = lod_vec3_from_float(mesh.normals[mesh.indices[i]]);
    assert_true(fabs(lod_vec3_length(n) - 1) < 1e-5);
  }
  lod_dynamic_destroy(dynamic);
}

/* UVs of their own for each vertex, others for patches with x > 0, so that numbers jump along a line; three materials by turns. */
static void paint(struct lod_patches *patches) {
  struct lod_patch_attributes *a = &patches->attributes;
  *a = (struct lod_patch_attributes){.has_uv = {true}, .has_colors = true, .width = 6, .count = 2 * patches->vertex_count};
  a->values = LOD_NEW(arena, 6 * (size_t)a->count, float);
  a->corners = lod_arena_alloc(arena, patches->patch_count, sizeof *a->corners);
  patches->materials = LOD_NEW(arena, patches->patch_count, uint32_t);
  for (uint32_t i = 0; i < 6 * a->count; i++)
    a->values[i] = (float)random_in(0, 1);
  for (uint32_t p = 0; p < patches->patch_count; p++) {
    const uint32_t *c = patches->corners[p];
    bool right = patches->positions[c[0]].x + patches->positions[c[1]].x + patches->positions[c[2]].x > 0;
    patches->materials[p] = p % 3 == 2 ? LOD_NONE : p % 3;
    for (int k = 0; k < 3; k++)
      a->corners[p][k] = 2 * c[k] + right;
  }
}

/* Every corner of every triangle drawn has the numbers that its patch has there, and is drawn with its patch's material. Which of the two
 * vertices of a seam a triangle took would show. */
static void assert_painted(const struct lod_dynamic *dynamic) {
  struct lod_dynamic_mesh mesh;
  const uint8_t *visible;
  const struct lod_patches *surface = lod_dynamic_surface(dynamic, &visible, NULL);
  lod_dynamic_mesh(dynamic, &mesh);
  assert_int_equal(mesh.width, 6);
  uint32_t *patch_of = LOD_NEW(arena, mesh.index_count / 3, uint32_t), *next = LOD_NEW_ZERO(arena, surface->patch_count, uint32_t), at = 0;
  lod_dynamic_triangle_patches(dynamic, patch_of);
  for (uint32_t g = 0; g < mesh.group_count; g++) {
    assert_int_equal(mesh.groups[g].first, at);
    for (; at < mesh.groups[g].first + mesh.groups[g].count; at++) {
      uint32_t p = patch_of[at / 3];
      const uint32_t(*triangles)[3];
      const struct lod_barycentric *domain;
      assert_int_equal(surface->materials[p], mesh.groups[g].material);
      assert_true(next[p] / 3 < lod_dynamic_domain(dynamic, p, &triangles, &domain));
      struct lod_barycentric b = domain[triangles[next[p] / 3][next[p] % 3]];
      next[p]++;
      float expected[LOD_PATCH_NUMBERS];
      lod_patch_attributes_mix(&surface->attributes, p, (const double[3]){b.u, b.v, b.w}, expected);
      for (uint32_t i = 0; i < 6; i++)
        assert_true(fabs((double)mesh.numbers[6 * (size_t)mesh.indices[at] + i] - (double)expected[i]) < 1e-5);
    }
  }
  assert_int_equal(at, mesh.index_count);
}

static void uvs_colours_and_materials_follow_the_view(void **state) {
  (void)state;
  for (int which = 0; which < 3; which++) {
    struct lod_patches patches = shape(which), strict;
    paint(&patches);
    assert_int_equal(lod_patches_make_strict(&patches, arena, &strict, NULL), LOD_OK);
    struct lod_dynamic *dynamic = open_dynamic(&patches), *smooth = open_dynamic(&strict);
    struct lod_dynamic_settings settings = lod_dynamic_defaults();
    for (int i = 0; i < 6; i++) {
      struct lod_dynamic_view view = random_view(i < 4 ? 1.5 : 0.9, i < 4 ? 6 : 1); /* the last from so near that patches are halved */
      settings.smoothness = LOD_SMOOTH_SHADED;
      settings.pixels = i < 4 ? 1 : 0.05;
      update(dynamic, &view, &settings);
      assert_painted(dynamic);
      settings.smoothness = LOD_SMOOTH_STRICT;
      update(smooth, &view, &settings);
      assert_painted(smooth);
    }
    lod_dynamic_destroy(dynamic);
    lod_dynamic_destroy(smooth);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(what_is_drawn_is_within_the_tolerance_in_pixels),
      cmocka_unit_test(no_view_opens_a_crack),
      cmocka_unit_test(uvs_colours_and_materials_follow_the_view),
      cmocka_unit_test(what_is_left_out_cannot_be_seen),
      cmocka_unit_test(only_what_the_view_asks_for_is_made_anew),
      cmocka_unit_test(there_are_no_facets_at_any_zoom),
      cmocka_unit_test(halving_leaves_the_surface_and_opens_no_crack),
      cmocka_unit_test(the_cone_holds_all_normals),
      cmocka_unit_test(folds_are_never_called_regular),
      cmocka_unit_test(grids_are_evaluated_within_their_rounding),
      cmocka_unit_test(strict_patches_have_one_tangent_plane_along_edges),
      cmocka_unit_test(strict_patches_are_drawn_and_stay_closed),
  };
  return cmocka_run_group_tests(tests, open_arena, close_arena);
}
