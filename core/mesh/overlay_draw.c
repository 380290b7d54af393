/* What a geomorph draws, from an overlay. */
#include <string.h>

#include "core/mesh/overlay_private.h"

/* A vertex to be: a node seen through the wedges of a triangle of each level. */
struct key {
  uint32_t node, coarse, fine; /* triangles; the places of the node on them say the rest */
  uint32_t wedges[6];          /* that weigh, LOD_NONE others */
};

struct weaver {
  const struct lod_overlay *overlay;
  const struct lod_mesh *coarse, *fine;
  const struct lod_morph_values *values;
  struct key *keys;
  uint32_t *slots, mask; /* hash table of vertex + 1 */
  struct lod_morph *morph;
};

/* The node on that triangle, or on its own when it does not lie there. */
static uint32_t weights_on(const struct lod_mesh *mesh, const struct lod_overlay_place *place, uint32_t face, int64_t weights[3]) {
  if (face != LOD_NONE && place->face != face && lod_overlay_on_face(mesh, place, face, weights))
    return face;
  for (int k = 0; k < 3; k++)
    weights[k] = place->face == LOD_NONE ? 0 : place->weights[k];
  return place->face;
}

static void find_wedges(const struct lod_mesh *mesh, uint32_t face, const int64_t weights[3], uint32_t wedges[3]) {
  uint32_t(*corners)[3] = mesh->corners != NULL ? mesh->corners : mesh->triangles;
  for (int k = 0; k < 3; k++)
    wedges[k] = face == LOD_NONE || weights[k] == 0 ? LOD_NONE : corners[face][k];
}

static uint32_t hash_key(const struct key *key) {
  uint32_t hash = key->node * 0x9e3779b1u;
  for (int i = 0; i < 6; i++)
    hash = (hash ^ (hash >> 15) ^ key->wedges[i]) * 0x85ebca6bu;
  return hash ^ (hash >> 13);
}

static void write_values(const struct lod_mesh *mesh, uint32_t face, const int64_t weights[3], const float *from, uint32_t count,
                         float *out) {
  uint32_t(*corners)[3] = mesh->corners != NULL ? mesh->corners : mesh->triangles;
  for (uint32_t i = 0; i < count; i++) {
    double sum = 0;
    for (int k = 0; k < 3 && from != NULL && face != LOD_NONE; k++)
      if (weights[k] != 0)
        sum += (double)from[(size_t)corners[face][k] * count + i] * ((double)weights[k] * (1.0 / LOD_OVERLAY_ONE));
    out[i] = (float)sum;
  }
}

static void write_vertex(struct weaver *w, const struct key *key, uint32_t coarse, const int64_t start[3], uint32_t fine,
                         const int64_t end[3]) {
  struct lod_morph *m = w->morph;
  uint32_t v = m->vertex_count++, count = w->values != NULL ? w->values->values : 0;
  const struct lod_overlay_place *from = &w->overlay->coarse[key->node], *to = &w->overlay->fine[key->node];
  struct lod_vec3 there = lod_overlay_position(w->fine, to);
  lod_vec3_to_float(there, m->end[v]);
  lod_vec3_to_float(from->face == LOD_NONE ? there : lod_overlay_position(w->coarse, from), m->start[v]);
  if (count == 0)
    return;
  write_values(w->fine, fine, end, w->values->fine, count, m->end_values + (size_t)v * count);
  if (coarse != LOD_NONE)
    write_values(w->coarse, coarse, start, w->values->coarse, count, m->start_values + (size_t)v * count);
  else
    memcpy(m->start_values + (size_t)v * count, m->end_values + (size_t)v * count, count * sizeof(float));
}

/* The vertex of a corner; a new one when none like it is there. */
static uint32_t vertex_of(struct weaver *w, uint32_t node, uint32_t coarse_face, uint32_t fine_face) {
  struct key key = {.node = node};
  int64_t start[3], end[3];
  key.coarse = weights_on(w->coarse, &w->overlay->coarse[node], coarse_face, start);
  key.fine = weights_on(w->fine, &w->overlay->fine[node], fine_face, end);
  find_wedges(w->coarse, key.coarse, start, key.wedges);
  find_wedges(w->fine, key.fine, end, key.wedges + 3);
  for (int half = 0; half < 6; half += 3) /* the same wedges in another order are the same */
    for (int pass = 0; pass < 2; pass++)
      for (int i = half; i < half + 2 - pass; i++)
        if (key.wedges[i] > key.wedges[i + 1]) {
          uint32_t x = key.wedges[i];
          key.wedges[i] = key.wedges[i + 1];
          key.wedges[i + 1] = x;
        }
  uint32_t slot = hash_key(&key) & w->mask;
  for (; w->slots[slot] != 0; slot = (slot + 1) & w->mask) {
    const struct key *there = &w->keys[w->slots[slot] - 1];
    if (there->node == node && memcmp(there->wedges, key.wedges, sizeof key.wedges) == 0)
      return w->slots[slot] - 1;
  }
  uint32_t v = w->morph->vertex_count;
  w->keys[v] = key;
  w->slots[slot] = v + 1;
  write_vertex(w, &key, key.coarse, start, key.fine, end);
  return v;
}

static enum lod_status weave(struct weaver *w, uint32_t triangles, bool exact, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_overlay *o = w->overlay;
  struct lod_morph *m = w->morph;
  uint32_t count = w->values != NULL ? w->values->values : 0, buckets = 64;
  size_t most = 3 * (size_t)triangles;
  while (buckets < 2 * most && buckets < 1u << 31)
    buckets *= 2;
  w->mask = buckets - 1;
  OVERLAY_TRY_ZERO(w->slots, scratch, buckets);
  OVERLAY_TRY_NEW(w->keys, scratch, most);
  struct lod_morph large = {0};
  OVERLAY_TRY_NEW(large.start, scratch, most);
  OVERLAY_TRY_NEW(large.end, scratch, most);
  if (count > 0) {
    OVERLAY_TRY_NEW(large.start_values, scratch, most * count);
    OVERLAY_TRY_NEW(large.end_values, scratch, most * count);
  }
  OVERLAY_TRY_NEW(large.triangles, arena, triangles);
  OVERLAY_TRY_NEW(large.fine_faces, arena, triangles);
  OVERLAY_TRY_NEW(large.coarse_faces, arena, triangles);
  *m = large;
  for (uint32_t i = 0; i < (exact ? o->triangle_count : w->fine->triangle_count); i++) {
    if (!exact && !overlay_takes_part(w->fine, i))
      continue;
    uint32_t fine = exact ? o->fine_faces[i] : i, coarse = exact ? o->coarse_faces[i] : LOD_NONE;
    if (exact && coarse != LOD_NONE && o->states[coarse] != LOD_OVERLAY_MAPPED)
      coarse = LOD_NONE;
    const uint32_t *nodes = exact ? o->triangles[i] : w->fine->triangles[i];
    for (int k = 0; k < 3; k++)
      m->triangles[m->triangle_count][k] = vertex_of(w, nodes[k], coarse, fine);
    m->fine_faces[m->triangle_count] = fine;
    m->coarse_faces[m->triangle_count++] = coarse;
  }
  OVERLAY_TRY_NEW(m->start, arena, m->vertex_count);
  OVERLAY_TRY_NEW(m->end, arena, m->vertex_count);
  memcpy(m->start, large.start, m->vertex_count * sizeof *m->start);
  memcpy(m->end, large.end, m->vertex_count * sizeof *m->end);
  if (count > 0) {
    OVERLAY_TRY_NEW(m->start_values, arena, (size_t)m->vertex_count * count);
    OVERLAY_TRY_NEW(m->end_values, arena, (size_t)m->vertex_count * count);
    memcpy(m->start_values, large.start_values, (size_t)m->vertex_count * count * sizeof(float));
    memcpy(m->end_values, large.end_values, (size_t)m->vertex_count * count * sizeof(float));
  }
  return LOD_OK;
}

static enum lod_status draw(const struct lod_overlay *overlay, const struct lod_mesh *coarse, const struct lod_mesh *fine,
                            const struct lod_morph_values *values, bool exact, struct lod_arena *arena, struct lod_morph *morph) {
  struct weaver w = {.overlay = overlay, .coarse = coarse, .fine = fine, .values = values, .morph = morph};
  *morph = (struct lod_morph){0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status =
      scratch == NULL ? LOD_MEMORY : weave(&w, exact ? overlay->triangle_count : fine->triangle_count, exact, arena, scratch);
  lod_arena_destroy(scratch);
  return status;
}

enum lod_status lod_overlay_fragments(const struct lod_overlay *overlay, const struct lod_mesh *coarse, const struct lod_mesh *fine,
                                      const struct lod_morph_values *values, struct lod_arena *arena, struct lod_morph *morph) {
  return draw(overlay, coarse, fine, values, true, arena, morph);
}

enum lod_status lod_overlay_vertices(const struct lod_overlay *overlay, const struct lod_mesh *coarse, const struct lod_mesh *fine,
                                     const struct lod_morph_values *values, struct lod_arena *arena, struct lod_morph *morph) {
  return draw(overlay, coarse, fine, values, false, arena, morph);
}

/* ---- matching ---- */

struct cells {
  double size;
  uint32_t mask, *begin, *members;
};

static uint32_t bucket_of(const struct cells *c, int64_t x, int64_t y, int64_t z) {
  uint64_t hash = (uint64_t)x * 0x9e3779b97f4a7c15u ^ (uint64_t)y * 0xc2b2ae3d27d4eb4fu ^ (uint64_t)z * 0x165667b19e3779f9u;
  return (uint32_t)(hash >> 32) & c->mask;
}

static void cell_of(const struct cells *c, const float p[3], int64_t cell[3]) {
  for (int k = 0; k < 3; k++) {
    double x = (double)p[k] / c->size;
    cell[k] = (int64_t)x - (x < 0);
  }
}

static enum lod_status fill_cells(struct cells *c, const struct lod_mesh *mesh, double size, struct lod_arena *arena) {
  uint32_t buckets = 64;
  while (buckets < mesh->vertex_count && buckets < 1u << 30)
    buckets *= 2;
  c->size = size;
  c->mask = buckets - 1;
  OVERLAY_TRY_ZERO(c->begin, arena, (size_t)buckets + 2);
  OVERLAY_TRY_NEW(c->members, arena, mesh->vertex_count);
  for (int pass = 0; pass < 2; pass++) {
    for (uint32_t v = 0; v < mesh->vertex_count; v++) {
      int64_t cell[3];
      cell_of(c, mesh->positions[v], cell);
      uint32_t b = bucket_of(c, cell[0], cell[1], cell[2]);
      if (pass == 0)
        c->begin[b + 2]++;
      else
        c->members[c->begin[b + 1]++] = v;
    }
    for (uint32_t b = 0; pass == 0 && b <= buckets; b++)
      c->begin[b + 1] += c->begin[b];
  }
  return LOD_OK;
}

static uint32_t nearest(const struct cells *c, const struct lod_mesh *mesh, const float p[3], double reach) {
  int64_t cell[3];
  double best = reach * reach;
  uint32_t found = LOD_NONE;
  struct lod_vec3 at = lod_vec3_from_float(p);
  cell_of(c, p, cell);
  for (int64_t i = 0; i < 27; i++) {
    uint32_t b = bucket_of(c, cell[0] + i % 3 - 1, cell[1] + i / 3 % 3 - 1, cell[2] + i / 9 - 1);
    for (uint32_t k = c->begin[b]; k < c->begin[b + 1]; k++) {
      double distance = lod_vec3_distance_squared(at, overlay_at(mesh, c->members[k]));
      if (distance < best || (distance == best && (found == LOD_NONE || c->members[k] < found))) {
        best = distance;
        found = c->members[k];
      }
    }
  }
  return found;
}

enum lod_status lod_overlay_match(const struct lod_mesh *coarse, const struct lod_mesh *fine, double reach, struct lod_arena *arena,
                                  uint32_t *parents) {
  struct cells of_fine, of_coarse;
  /* So that a cell's number fits and neighbours within reach lie in neighbouring cells. */
  double size = fmax(reach, 1e-9 * fmax(lod_mesh_magnitude(coarse), lod_mesh_magnitude(fine)));
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : LOD_OK;
  if (!(size > 0))
    size = 1;
  if (status == LOD_OK)
    status = fill_cells(&of_fine, fine, size, scratch);
  if (status == LOD_OK)
    status = fill_cells(&of_coarse, coarse, size, scratch);
  for (uint32_t v = 0; status == LOD_OK && v < coarse->vertex_count; v++) {
    uint32_t to = nearest(&of_fine, fine, coarse->positions[v], reach);
    parents[v] = to != LOD_NONE && nearest(&of_coarse, coarse, fine->positions[to], reach) == v ? to : LOD_NONE;
  }
  lod_arena_destroy(scratch);
  return status;
}
