/* The certificate on a square of two triangles, where one can see who certifies whom. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include "core/envelope/certificate.h"

static float square_positions[4][3] = {{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {0, 2, 0}};
static uint32_t square_triangles[2][3] = {{0, 1, 2}, {0, 2, 3}};

/* The square with its diagonal from (0, 0) to (2, 2) as source, the other diagonal as the surface that it was changed to. */
struct fixture {
  struct lod_arena *arena;
  struct lod_mesh source;
  struct lod_certificate *certificate;
  struct lod_candidate unchanged; /* what gather adds; face LOD_NONE = nothing */
};

static const struct lod_vec3 kCorner[4] = {{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {0, 2, 0}};

static struct lod_candidate candidate(uint32_t face, struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  return (struct lod_candidate){.corner = {a, b, c}, .face = face};
}

struct gathered {
  struct fixture *fixture;
  struct lod_candidate faces[3];
};

static void gather(void *context, struct lod_change *change) {
  struct gathered *gathered = context;
  if (gathered->fixture->unchanged.face != LOD_NONE)
    gathered->faces[change->face_count++] = gathered->fixture->unchanged;
}

/* Tries to replace `changing` by one or two faces, and makes it so when it may. */
static bool replace(struct fixture *f, const uint32_t *changing, uint32_t changing_count, const struct lod_candidate *faces,
                    uint32_t count) {
  struct gathered gathered = {.fixture = f};
  for (uint32_t i = 0; i < count; i++)
    gathered.faces[i] = faces[i];
  struct lod_change change = {.gather = gather, .context = &gathered, .changing = changing, .changing_count = changing_count};
  change.faces = gathered.faces;
  change.face_count = change.fresh_count = count;
  change.witness = LOD_NONE;
  for (uint32_t i = 0; i < count; i++)
    for (int k = 0; k < 3; k++)
      change.hints[i][k] = LOD_NONE;
  enum lod_status status;
  bool may = lod_certificate_try(f->certificate, &change, &status);
  assert_int_equal(status, LOD_OK);
  if (may)
    assert_int_equal(lod_certificate_commit(f->certificate, &change), LOD_OK);
  return may;
}

static void set_up(struct fixture *f) {
  *f = (struct fixture){.arena = lod_arena_create(0), .unchanged = {.face = LOD_NONE}};
  assert_non_null(f->arena);
  f->source = (struct lod_mesh){.vertex_count = 4, .triangle_count = 2, .positions = square_positions, .triangles = square_triangles};
  struct lod_bvh *bvh;
  assert_int_equal(lod_bvh_create(&f->source, 1, f->arena, &bvh), LOD_OK);
  assert_int_equal(lod_certificate_create(&f->source, bvh, NULL, 0.1, f->arena, &f->certificate), LOD_OK);
  /* The flip: each source triangle is now certified by both faces, half and half. */
  uint32_t both[2] = {0, 1};
  struct lod_candidate flipped[2] = {candidate(0, kCorner[0], kCorner[1], kCorner[3]), candidate(1, kCorner[1], kCorner[2], kCorner[3])};
  assert_true(replace(f, both, 2, flipped, 2));
}

/* Shrinking either face leaves a half of some source triangle bare, whichever of its two faces it is mainly charged to. */
static void test_a_triangle_certified_by_two_faces_is_charged_to_both(void **state) {
  (void)state;
  struct lod_vec3 middle = {1, 1, 0};
  for (uint32_t face = 0; face < 2; face++)
    for (uint32_t side = 0; side < 2; side++) {
      struct fixture f;
      set_up(&f);
      struct lod_vec3 tip = kCorner[face == 0 ? 0 : 2], end = kCorner[side == 0 ? 1 : 3];
      f.unchanged = face == 0 ? candidate(1, kCorner[1], kCorner[2], kCorner[3]) : candidate(0, kCorner[0], kCorner[1], kCorner[3]);
      struct lod_candidate shrunk = candidate(face, tip, end, middle);
      assert_false(replace(&f, &face, 1, &shrunk, 1));
      lod_arena_destroy(f.arena);
    }
}

/* Replacing a face by itself: the source triangles that straddle it need the neighbour's word for their other half. */
static void test_unchanged_neighbours_certify_what_straddles_them(void **state) {
  (void)state;
  struct fixture f;
  set_up(&f);
  uint32_t face = 0;
  struct lod_candidate same = candidate(0, kCorner[0], kCorner[1], kCorner[3]);
  assert_false(replace(&f, &face, 1, &same, 1));
  f.unchanged = candidate(1, kCorner[1], kCorner[2], kCorner[3]);
  assert_true(replace(&f, &face, 1, &same, 1));
  lod_arena_destroy(f.arena);
}

/* A roof over the square: its ridge is the farthest from the source, its eaves lie on it. */
static void test_forward_refuses_a_face_that_leaves_epsilon(void **state) {
  (void)state;
  struct fixture f;
  set_up(&f);
  uint32_t both[2] = {0, 1};
  for (int high = 0; high < 2; high++) {
    struct lod_vec3 ridge = {2, 2, high ? 0.11 : 0.09};
    struct lod_candidate roof[2] = {candidate(0, kCorner[0], kCorner[1], kCorner[3]), candidate(1, kCorner[1], ridge, kCorner[3])};
    assert_int_equal(replace(&f, both, 2, roof, 2), !high);
  }
  lod_arena_destroy(f.arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_a_triangle_certified_by_two_faces_is_charged_to_both),
      cmocka_unit_test(test_unchanged_neighbours_certify_what_straddles_them),
      cmocka_unit_test(test_forward_refuses_a_face_that_leaves_epsilon),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
