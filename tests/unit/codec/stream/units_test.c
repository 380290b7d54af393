/* Steps in units: each decoded by itself, joined to the bit, and drawn in part without cracks. */
#include "codec/stream/units.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <stdlib.h>
#include <string.h>

#include "codec/stream/bytes.h"
#include "core/mesh/overlay.h"
#include "core/retile/retile.h"
#include "tests/data/arena.h"
#include "tests/data/nested.h"
#include "tests/data/shapes.h"

enum { MOST = 150 }; /* coarse triangles of a patch */

struct stream {
  struct lod_rounded base, fine;
  uint32_t *kept;
  uint8_t *bytes;
  size_t size;
  struct lod_units units;
  struct lod_delta_level *levels;
  const struct lod_delta_level **at_hand;
};

static struct lod_retile retile_torus(void) {
  struct lod_mesh torus = lod_shape_torus(arena, 2, 0.7, 90, 45);
  const uint32_t counts[] = {400, 1700};
  struct lod_retile_settings settings = lod_retile_defaults();
  struct lod_retile retile;
  settings.vertices = counts;
  settings.level_count = 2;
  assert_int_equal(lod_retile_create(&torus, &settings, NULL, arena, &retile, NULL), LOD_OK);
  return retile;
}

static struct lod_mesh bare(const struct lod_mesh *mesh) {
  return (struct lod_mesh){.vertex_count = mesh->vertex_count,
                           .triangle_count = mesh->triangle_count,
                           .positions = mesh->positions,
                           .triangles = mesh->triangles};
}

static struct stream encode(void) {
  struct stream s = {0};
  struct lod_problem problem = {0};
  struct lod_retile retile = retile_torus();
  struct lod_mesh coarse = bare(&retile.levels[0].mesh), fine = bare(&retile.levels[1].mesh);
  s.base = lod_round_mesh(&coarse, 2e-3, arena);
  s.fine = lod_round_mesh(&fine, 1e-3, arena);
  s.kept = lod_round_kept(&s.base, &s.fine, retile.levels[0].parents, coarse.vertex_count, arena);
  struct lod_delta_encode_request request = lod_delta_encode_defaults();
  request.base = &s.base.mesh;
  request.fine = &s.fine.mesh;
  request.kept = s.kept;
  request.grid = s.fine.grid;
  request.to = 1;
  request.from = 0;
  if (lod_units_encode(&request, MOST, arena, &s.bytes, &s.size, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  assert_true(s.size > 0);
  return s;
}

static void open_stream(struct stream *s, const struct lod_mesh *base) {
  struct lod_problem problem = {0};
  if (lod_units_open(s->bytes, s->size, base, NULL, arena, &s->units, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  s->levels = LOD_NEW_ZERO(arena, s->units.header.patch_count, struct lod_delta_level);
  s->at_hand = LOD_NEW_ZERO(arena, s->units.header.patch_count, const struct lod_delta_level *);
}

static void take(struct stream *s, uint32_t p) {
  struct lod_problem problem = {0};
  const struct lod_units_patch *patch = &s->units.patches[p];
  if (patch->size == 0)
    return;
  if (lod_units_decode(&s->units, p, s->bytes + patch->offset, patch->size, NULL, arena, &s->levels[p], &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  s->at_hand[p] = &s->levels[p];
}

static void all_units_together_are_the_finer_level_to_the_bit(void **state) {
  (void)state;
  struct stream s = encode();
  struct lod_delta_level joined;
  uint32_t checksum, expected;
  open_stream(&s, &s.base.mesh);
  const uint32_t count = s.units.header.patch_count;
  assert_true(count >= 6 && s.units.header.size == s.size && s.units.header.primer_patch == 0);
  take(&s, 0);
  for (uint32_t p = count; p-- > 1;) /* in any order behind the first */
    take(&s, p);
  assert_int_equal(lod_units_join(&s.units, s.at_hand, arena, &joined, NULL), LOD_OK);
  assert_int_equal(lod_delta_checksum(&joined.mesh, arena, &checksum), LOD_OK);
  assert_int_equal(lod_delta_checksum(&s.fine.mesh, arena, &expected), LOD_OK);
  assert_int_equal(checksum, expected);
  for (uint32_t v = 0; v < s.base.mesh.vertex_count; v++) {
    assert_int_equal(joined.kept[v] == LOD_NONE, s.kept[v] == LOD_NONE);
    if (s.kept[v] != LOD_NONE)
      assert_memory_equal(joined.mesh.positions[joined.kept[v]], s.fine.mesh.positions[s.kept[v]], sizeof(float[3]));
  }
  uint32_t triangles = 0, coarse = 0; /* every triangle is in exactly one patch */
  for (uint32_t p = 0; p < count; p++) {
    triangles += s.units.patches[p].triangles;
    coarse += s.units.patches[p].coarse_count;
    assert_true(s.units.patches[p].coarse_count <= MOST);
  }
  assert_int_equal(triangles, s.fine.mesh.triangle_count);
  assert_int_equal(coarse, s.base.mesh.triangle_count);
}

/* The same level, vertices backwards, triangles backwards and turned. */
static struct lod_mesh shuffled(const struct lod_mesh *mesh) {
  struct lod_mesh out = *mesh;
  out.positions = lod_arena_alloc(arena, mesh->vertex_count, sizeof *out.positions);
  out.triangles = lod_arena_alloc(arena, mesh->triangle_count, sizeof *out.triangles);
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    memcpy(out.positions[mesh->vertex_count - 1 - v], mesh->positions[v], sizeof *out.positions);
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (uint32_t i = 0; i < 3; i++)
      out.triangles[mesh->triangle_count - 1 - t][(i + t) % 3] = mesh->vertex_count - 1 - mesh->triangles[t][i];
  return out;
}

static void patches_do_not_depend_on_the_order_of_the_base(void **state) {
  (void)state;
  struct stream s = encode(), other = s;
  struct lod_delta_level joined;
  struct lod_mesh base = shuffled(&s.base.mesh);
  open_stream(&s, &s.base.mesh);
  open_stream(&other, &base);
  for (uint32_t p = 0; p < s.units.header.patch_count; p++) {
    const struct lod_units_patch *a = &s.units.patches[p], *b = &other.units.patches[p];
    assert_int_equal(a->coarse_count, b->coarse_count);
    for (uint32_t k = 0; k < a->coarse_count; k++)
      assert_int_equal(a->coarse[k], s.base.mesh.triangle_count - 1 - b->coarse[a->coarse_count - 1 - k]);
    take(&other, p);
  }
  assert_int_equal(lod_units_join(&other.units, other.at_hand, arena, &joined, NULL), LOD_OK);
}

/* ---- drawing ---- */

struct edge {
  float ends[6]; /* the lower end first */
  int way;
};

static int compare_edges(const void *a, const void *b) {
  return memcmp(a, b, sizeof(float[6]));
}

static void at(const struct lod_morph *m, uint32_t v, float t, float p[3]) {
  const float own = m->settled[v] ? 1 : t;
  for (int i = 0; i < 3; i++)
    p[i] = own == 0 ? m->start[v][i] : own == 1 ? m->end[v][i] : m->start[v][i] + own * (m->end[v][i] - m->start[v][i]);
}

/* Every side of every triangle lies against one that runs the other way between the same two points, to the bit: no hole, no crack. */
static void assert_watertight(const struct lod_morph *m, float t) {
  struct edge *edges = calloc(3 * (size_t)m->triangle_count, sizeof *edges);
  size_t count = 0;
  for (uint32_t k = 0; k < m->triangle_count; k++)
    for (int i = 0; i < 3; i++) {
      float a[3], b[3];
      at(m, m->triangles[k][i], t, a);
      at(m, m->triangles[k][(i + 1) % 3], t, b);
      const int order = memcmp(a, b, sizeof a);
      if (order == 0)
        continue; /* shorter than a float tells */
      memcpy(edges[count].ends, order < 0 ? a : b, sizeof a);
      memcpy(edges[count].ends + 3, order < 0 ? b : a, sizeof a);
      edges[count++].way = order < 0 ? 1 : -1;
    }
  qsort(edges, count, sizeof *edges, compare_edges);
  for (size_t i = 0, end; i < count; i = end) {
    int sum = 0;
    for (end = i; end < count && compare_edges(&edges[i], &edges[end]) == 0; end++)
      sum += edges[end].way;
    assert_int_equal(sum, 0);
  }
  free(edges);
}

/* How many coarse triangles are drawn as fragments. */
static uint32_t draw(struct stream *s, uint8_t *states, bool first, struct lod_morph *morph) {
  struct lod_delta_level joined;
  struct lod_overlay overlay;
  const uint32_t triangles = s->base.mesh.triangle_count;
  assert_int_equal(lod_units_join(&s->units, s->at_hand, arena, &joined, NULL), LOD_OK);
  uint32_t *parents = lod_arena_copy(arena, joined.kept, s->base.mesh.vertex_count * sizeof *parents);
  lod_units_settle(&s->units, s->at_hand, parents);
  assert_int_equal(lod_overlay_create(&s->base.mesh, &joined.mesh, parents, NULL, arena, &overlay, NULL), LOD_OK);
  assert_int_equal(lod_overlay_part(&overlay, &s->base.mesh, &joined.mesh, NULL, first ? NULL : states, arena, morph), LOD_OK);
  memcpy(states, overlay.states, triangles);
  return overlay.mapped;
}

static void what_is_drawn_of_some_units_has_no_crack_and_grows(void **state) {
  (void)state;
  struct stream s = encode();
  open_stream(&s, &s.base.mesh);
  const uint32_t count = s.units.header.patch_count, triangles = s.base.mesh.triangle_count;
  uint8_t *states = LOD_NEW_ZERO(arena, triangles, uint8_t);
  uint32_t mapped = 0, settled = 0;
  for (uint32_t p = 0; p < count; p++) {
    struct lod_morph morph;
    take(&s, p);
    const uint32_t now = draw(&s, states, p == 0, &morph);
    assert_true(now >= mapped);
    mapped = now;
    for (int i = 0; i <= 4; i++)
      assert_watertight(&morph, (float)i / 4);
    settled = 0;
    for (uint32_t v = 0; v < morph.vertex_count; v++)
      settled += morph.settled[v];
    for (uint32_t k = 0; k < morph.triangle_count && p == 0; k++) /* beside the first patch it is the coarse level */
      for (int i = 0; i < 3 && morph.fine_faces[k] == LOD_NONE; i++)
        assert_memory_equal(morph.start[morph.triangles[k][i]], morph.end[morph.triangles[k][i]], sizeof(float[3]));
    if (p == 0)
      assert_true(mapped > MOST / 4 && mapped <= s.units.patches[0].coarse_count && settled == 0);
  }
  assert_int_equal(mapped, triangles);
  assert_true(settled > s.fine.mesh.vertex_count / 2);
}

/* ---- bad input ---- */

static void units_behind_the_first_need_it(void **state) {
  (void)state;
  struct stream s = encode();
  struct lod_problem problem = {0};
  struct lod_delta_level level;
  open_stream(&s, &s.base.mesh);
  const struct lod_units_patch *patch = &s.units.patches[1];
  assert_int_equal(lod_units_decode(&s.units, 1, s.bytes + patch->offset, patch->size, NULL, arena, &level, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "wrong-primer");
  take(&s, 0);
  assert_int_equal(lod_units_decode(&s.units, 1, s.bytes + patch->offset, patch->size, NULL, arena, &level, &problem), LOD_OK);
  assert_int_equal(lod_units_decode(&s.units, 99, s.bytes, s.size, NULL, arena, &level, &problem), LOD_BAD_INPUT);
  assert_int_equal(lod_units_decode(&s.units, 1, s.bytes + s.units.patches[2].offset, patch->size, NULL, arena, &level, &problem),
                   LOD_BAD_INPUT);
}

static void every_prefix_of_an_index_or_a_unit_fails_with_a_sentence(void **state) {
  (void)state;
  struct stream s = encode();
  struct lod_units units;
  struct lod_delta_level level;
  open_stream(&s, &s.base.mesh);
  for (size_t size = 0; size < s.units.header.index_bytes; size++) {
    struct lod_problem problem = {0};
    uint8_t *copy = malloc(size + 1); /* its own block, so that a read behind it is seen */
    memcpy(copy, s.bytes, size);
    assert_int_equal(lod_units_open(copy, size, &s.base.mesh, NULL, arena, &units, &problem), LOD_BAD_INPUT);
    assert_string_equal(problem.type, "truncated");
    free(copy);
  }
  for (size_t size = 0; size < s.units.patches[0].size; size++) {
    struct lod_problem problem = {0};
    assert_int_equal(lod_units_decode(&s.units, 0, s.bytes + s.units.patches[0].offset, size, NULL, arena, &level, &problem),
                     LOD_BAD_INPUT);
    assert_string_equal(problem.type, "truncated");
  }
}

static void a_flipped_bit_in_an_index_or_a_unit_fails(void **state) {
  (void)state;
  struct stream s = encode();
  struct lod_units units;
  struct lod_delta_level level;
  open_stream(&s, &s.base.mesh);
  const size_t end = s.units.header.index_bytes + s.units.patches[0].size;
  for (size_t bit = 0; bit < 8 * end; bit++) {
    struct lod_problem problem = {0};
    s.bytes[bit / 8] ^= (uint8_t)(1 << bit % 8);
    enum lod_status status = lod_units_open(s.bytes, s.size, &s.base.mesh, NULL, arena, &units, &problem);
    if (status == LOD_OK)
      status = lod_units_decode(&units, 0, s.bytes + units.patches[0].offset, units.patches[0].size, NULL, arena, &level, &problem);
    assert_true(status == LOD_BAD_INPUT || status == LOD_UNSUPPORTED);
    assert_true(problem.detail[0] != '\0');
    s.bytes[bit / 8] ^= (uint8_t)(1 << bit % 8);
  }
}

static void a_wrong_base_or_version_is_refused(void **state) {
  (void)state;
  struct stream s = encode();
  struct lod_units units;
  struct lod_problem problem = {0};
  struct lod_mesh other = s.base.mesh;
  other.positions = lod_arena_copy(arena, other.positions, other.vertex_count * sizeof *other.positions);
  other.positions[7][1] += s.base.grid.step;
  assert_int_equal(lod_units_open(s.bytes, s.size, &other, NULL, arena, &units, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "wrong-base");
  problem = (struct lod_problem){0};
  s.bytes[4]++;
  assert_int_equal(lod_units_open(s.bytes, s.size, &s.base.mesh, NULL, arena, &units, &problem), LOD_UNSUPPORTED);
  assert_string_equal(problem.type, "units-version");
  s.bytes[4]--;
  struct lod_delta_limits limits = {.max_triangles = s.fine.mesh.triangle_count - 1};
  assert_int_equal(lod_units_open(s.bytes, s.size, &s.base.mesh, &limits, arena, &units, &problem), LOD_LIMIT);
}

/* A correct index of the stream's base, whose patches have no frames. */
static size_t write_empty_index(const struct stream *s, uint8_t *bytes) {
  const struct lod_units_header *h = &s->units.header;
  struct lod_writer w = {.at = bytes};
  memcpy(w.at, "LODU", 4);
  w.at += 4;
  lod_write_fixed(&w, LOD_UNITS_VERSION, 1);
  lod_write_fixed(&w, 0, 1);
  w.at += 4;
  const uint32_t counts[] = {h->from, h->to, 0, 1, h->base_vertices, 0, 0, h->most_triangles, h->patch_count};
  for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
    lod_write_varint(&w, counts[i]);
  lod_write_fixed(&w, h->base_checksum, 4);
  lod_write_fixed(&w, 0, 4);
  for (int i = 0; i < 3; i++)
    lod_write_float(&w, h->grid.origin[i]);
  lod_write_float(&w, h->grid.step);
  for (uint32_t i = 0; i < 3 * h->patch_count; i++)
    lod_write_varint(&w, 0);
  struct lod_writer length = {.at = bytes + 6};
  lod_write_fixed(&length, (uint32_t)(w.at - bytes) + 4, 4);
  lod_write_fixed(&w, lod_crc32(bytes, (size_t)(w.at - bytes)), 4);
  return (size_t)(w.at - bytes);
}

static void a_step_without_a_frame_is_neither_read_nor_written(void **state) {
  (void)state;
  struct stream s = encode();
  struct lod_problem problem = {0};
  struct lod_units units;
  uint8_t bytes[4096];
  open_stream(&s, &s.base.mesh);
  assert_true(s.units.header.primer_patch < s.units.header.patch_count && 200 + 3 * s.units.header.patch_count < sizeof bytes);
  const size_t size = write_empty_index(&s, bytes);
  assert_int_equal(lod_units_open(bytes, size, &s.base.mesh, NULL, arena, &units, &problem), LOD_BAD_INPUT);
  assert_string_equal(problem.type, "units");
  assert_non_null(strstr(problem.detail, "nothing to decode"));
  const struct lod_mesh nothing = {0};
  struct lod_delta_encode_request request = lod_delta_encode_defaults();
  uint32_t *gone = LOD_NEW(arena, s.base.mesh.vertex_count, uint32_t);
  memset(gone, 0xff, s.base.mesh.vertex_count * sizeof *gone);
  request.base = &s.base.mesh;
  request.fine = &nothing;
  request.kept = gone;
  request.grid = s.fine.grid;
  uint8_t *written;
  size_t length = 1;
  assert_int_equal(lod_units_encode(&request, MOST, arena, &written, &length, &problem), LOD_OK);
  assert_int_equal(length, 0);
}

static void seams_and_colours_come_back_with_units(void **state) {
  (void)state;
  struct lod_mesh coarse = lod_shape_grid(arena, 1, 16, 0.1), fine = lod_shape_grid(arena, 1, 64, 0.1);
  coarse.wedge_count = 0;
  coarse.corners = NULL;
  struct stream s = {.base = lod_round_mesh(&coarse, 1.0 / 1024, arena), .fine = lod_round_mesh(&fine, 1.0 / 4096, arena)};
  uint32_t *parents = LOD_NEW(arena, coarse.vertex_count, uint32_t);
  struct lod_problem problem = {0};
  for (uint32_t v = 0; v < coarse.vertex_count; v++)
    parents[v] = v / 17 * 4 * 65 + v % 17 * 4;
  struct lod_delta_encode_request request = lod_delta_encode_defaults();
  request.base = &s.base.mesh;
  request.fine = &s.fine.mesh;
  request.kept = lod_round_kept(&s.base, &s.fine, parents, coarse.vertex_count, arena);
  request.grid = s.fine.grid;
  request.from = 0;
  request.to = 1;
  if (lod_units_encode(&request, MOST, arena, &s.bytes, &s.size, &problem) != LOD_OK)
    fail_msg("%s", problem.detail);
  open_stream(&s, &s.base.mesh);
  for (uint32_t p = 0; p < s.units.header.patch_count; p++)
    take(&s, p);
  struct lod_delta_level joined;
  assert_int_equal(lod_units_join(&s.units, s.at_hand, arena, &joined, &problem), LOD_OK);
  assert_true(lod_mesh_check(&joined.mesh, NULL));
  assert_int_equal(joined.mesh.wedge_count, s.fine.mesh.wedge_count);
  assert_non_null(joined.mesh.uvs[0]);
  double sums[2] = {0, 0}; /* corners of all triangles: the same pairs of place and UV */
  const struct lod_mesh *meshes[2] = {&joined.mesh, &s.fine.mesh};
  for (int m = 0; m < 2; m++)
    for (uint32_t t = 0; t < meshes[m]->triangle_count; t++)
      for (int i = 0; i < 3; i++) {
        const float *uv = meshes[m]->uvs[0][meshes[m]->corners[t][i]], *p = meshes[m]->positions[meshes[m]->triangles[t][i]];
        sums[m] += ((double)uv[0] * 3 + (double)uv[1] * 7) * ((double)p[0] * 5 + (double)p[1] * 11 + 1);
      }
  assert_true(sums[0] - sums[1] < 1e-9 && sums[1] - sums[0] < 1e-9);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(all_units_together_are_the_finer_level_to_the_bit),
      cmocka_unit_test(patches_do_not_depend_on_the_order_of_the_base),
      cmocka_unit_test(what_is_drawn_of_some_units_has_no_crack_and_grows),
      cmocka_unit_test(units_behind_the_first_need_it),
      cmocka_unit_test(every_prefix_of_an_index_or_a_unit_fails_with_a_sentence),
      cmocka_unit_test(a_flipped_bit_in_an_index_or_a_unit_fails),
      cmocka_unit_test(a_wrong_base_or_version_is_refused),
      cmocka_unit_test(a_step_without_a_frame_is_neither_read_nor_written),
      cmocka_unit_test(seams_and_colours_come_back_with_units),
  };
  return cmocka_run_group_tests(tests, open_arena, close_arena);
}
