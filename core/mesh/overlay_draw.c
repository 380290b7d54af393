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
  const struct overlay_part *part; /* NULL: all of it */
  struct key *keys;
  uint32_t *slots, mask; /* hash table of vertex + 1 */
  struct lod_morph *morph;
};

/* Where a node lies on the coarse level. Beyond the overlay's own nodes: coarse vertices, then middles of coarse triangles. */
static struct lod_overlay_place coarse_place(const struct weaver *w, uint32_t node, uint32_t face) {
  if (node < w->overlay->node_count)
    return w->overlay->coarse[node];
  struct lod_overlay_place place = {.face = face};
  node -= w->overlay->node_count;
  for (int k = 0; k < 3; k++)
    place.weights[k] =
        node >= w->coarse->vertex_count ? LOD_OVERLAY_ONE / 3u + (k == 0) : (w->coarse->triangles[face][k] == node ? LOD_OVERLAY_ONE : 0u);
  return place;
}

static struct lod_overlay_place fine_place(const struct weaver *w, uint32_t node) {
  return node < w->overlay->node_count ? w->overlay->fine[node] : (struct lod_overlay_place){.face = LOD_NONE};
}

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
  const struct lod_overlay_place from = coarse_place(w, key->node, coarse), to = fine_place(w, key->node);
  const bool held = w->part != NULL && (key->node >= w->overlay->node_count || w->part->held[key->node] != 0);
  const struct lod_vec3 there = held ? lod_overlay_position(w->coarse, &from) : lod_overlay_position(w->fine, &to);
  lod_vec3_to_float(there, m->end[v]);
  lod_vec3_to_float(from.face == LOD_NONE ? there : lod_overlay_position(w->coarse, &from), m->start[v]);
  if (m->settled != NULL)
    m->settled[v] = key->node < w->overlay->node_count && w->part->settled[key->node] != 0;
  if (count == 0)
    return;
  if (held) {
    write_values(w->coarse, coarse, start, w->values->coarse, count, m->start_values + (size_t)v * count);
    memcpy(m->end_values + (size_t)v * count, m->start_values + (size_t)v * count, count * sizeof(float));
    return;
  }
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
  const struct lod_overlay_place from = coarse_place(w, node, coarse_face), to = fine_place(w, node);
  key.coarse = weights_on(w->coarse, &from, coarse_face, start);
  key.fine = weights_on(w->fine, &to, fine_face, end);
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

/* Room for so many triangles; the arrays of vertices are shortened at the end. */
static enum lod_status open_weaver(struct weaver *w, uint32_t triangles, struct lod_arena *arena, struct lod_arena *scratch) {
  uint32_t count = w->values != NULL ? w->values->values : 0, buckets = 64;
  size_t most = 3 * (size_t)triangles;
  while (buckets < 2 * most && buckets < 1u << 31)
    buckets *= 2;
  w->mask = buckets - 1;
  OVERLAY_TRY_ZERO(w->slots, scratch, buckets);
  OVERLAY_TRY_NEW(w->keys, scratch, most);
  struct lod_morph *m = w->morph;
  OVERLAY_TRY_NEW(m->start, scratch, most);
  OVERLAY_TRY_NEW(m->end, scratch, most);
  if (w->part != NULL)
    OVERLAY_TRY_NEW(m->settled, scratch, most);
  if (count > 0) {
    OVERLAY_TRY_NEW(m->start_values, scratch, most * count);
    OVERLAY_TRY_NEW(m->end_values, scratch, most * count);
  }
  OVERLAY_TRY_NEW(m->triangles, arena, triangles);
  OVERLAY_TRY_NEW(m->fine_faces, arena, triangles);
  OVERLAY_TRY_NEW(m->coarse_faces, arena, triangles);
  return LOD_OK;
}

static enum lod_status close_weaver(struct weaver *w, struct lod_arena *arena) {
  struct lod_morph *m = w->morph;
  const size_t vertices = m->vertex_count, values = w->values != NULL ? vertices * w->values->values : 0;
  m->start = lod_arena_copy(arena, m->start, vertices * sizeof *m->start);
  m->end = lod_arena_copy(arena, m->end, vertices * sizeof *m->end);
  if (m->settled != NULL && (m->settled = lod_arena_copy(arena, m->settled, vertices)) == NULL)
    return LOD_MEMORY;
  if (m->start == NULL || m->end == NULL)
    return LOD_MEMORY;
  if (values == 0)
    return LOD_OK;
  m->start_values = lod_arena_copy(arena, m->start_values, values * sizeof(float));
  m->end_values = lod_arena_copy(arena, m->end_values, values * sizeof(float));
  return m->start_values == NULL || m->end_values == NULL ? LOD_MEMORY : LOD_OK;
}

static void add_triangle(struct weaver *w, uint32_t a, uint32_t b, uint32_t c, uint32_t coarse, uint32_t fine) {
  struct lod_morph *m = w->morph;
  const uint32_t nodes[3] = {a, b, c};
  for (int k = 0; k < 3; k++)
    m->triangles[m->triangle_count][k] = vertex_of(w, nodes[k], coarse, fine);
  m->fine_faces[m->triangle_count] = fine;
  m->coarse_faces[m->triangle_count++] = coarse;
}

/* A coarse triangle as it is, cut where fragments beside it have corners on its sides. */
static void add_whole(struct weaver *w, uint32_t t) {
  const struct lod_overlay *o = w->overlay;
  const uint32_t first = o->node_count, middle = first + w->coarse->vertex_count + t;
  uint32_t sides[3], lone = 3, several = 0;
  for (uint32_t k = 0; k < 3; k++) {
    sides[k] = overlay_part_count(w->part, o, 3 * t + k);
    several += sides[k] > 0;
    lone = sides[k] > 0 ? k : lone;
  }
  if (several == 0) {
    const uint32_t *v = w->coarse->triangles[t];
    add_triangle(w, first + v[0], first + v[1], first + v[2], t, LOD_NONE);
    return;
  }
  for (uint32_t k = 0; k < 3; k++) { /* a fan around the corner opposite, or around the middle */
    const uint32_t from = first + w->coarse->triangles[t][k], to = first + w->coarse->triangles[t][(k + 1) % 3];
    const uint32_t top = several > 1 ? middle : first + w->coarse->triangles[t][(lone + 2) % 3];
    if (several == 1 && k != lone)
      continue;
    uint32_t last = from;
    for (uint32_t i = 0; i <= sides[k]; i++) {
      const uint32_t next = i < sides[k] ? overlay_part_node(w->part, o, 3 * t + k, i) : to;
      add_triangle(w, last, next, top, t, LOD_NONE);
      last = next;
    }
  }
}

/* Triangles that are drawn. */
static uint32_t count_triangles(const struct weaver *w, bool exact) {
  const struct lod_overlay *o = w->overlay;
  uint32_t count = exact ? o->triangle_count : w->fine->triangle_count;
  for (uint32_t t = 0; w->part != NULL && t < w->coarse->triangle_count; t++)
    for (uint32_t k = 0; o->states[t] != LOD_OVERLAY_MAPPED && k < 3; k++)
      count += 1 + overlay_part_count(w->part, o, 3 * t + k);
  return count;
}

static enum lod_status weave(struct weaver *w, bool exact, struct lod_arena *arena, struct lod_arena *scratch) {
  const struct lod_overlay *o = w->overlay;
  LOD_TRY(open_weaver(w, count_triangles(w, exact), arena, scratch));
  for (uint32_t i = 0; i < (exact ? o->triangle_count : w->fine->triangle_count); i++) {
    if (!exact && !overlay_takes_part(w->fine, i))
      continue;
    uint32_t fine = exact ? o->fine_faces[i] : i, coarse = exact ? o->coarse_faces[i] : LOD_NONE;
    if (exact && coarse != LOD_NONE && o->states[coarse] != LOD_OVERLAY_MAPPED)
      coarse = LOD_NONE;
    if (w->part != NULL && coarse == LOD_NONE)
      continue;
    const uint32_t *nodes = exact ? o->triangles[i] : w->fine->triangles[i];
    add_triangle(w, nodes[0], nodes[1], nodes[2], coarse, fine);
  }
  for (uint32_t t = 0; w->part != NULL && t < w->coarse->triangle_count; t++)
    if (o->states[t] != LOD_OVERLAY_MAPPED && o->states[t] != LOD_OVERLAY_EMPTY)
      add_whole(w, t);
  return close_weaver(w, arena);
}

static enum lod_status draw(const struct lod_overlay *overlay, const struct lod_mesh *coarse, const struct lod_mesh *fine,
                            const struct lod_morph_values *values, bool exact, struct lod_arena *arena, struct lod_morph *morph) {
  struct weaver w = {.overlay = overlay, .coarse = coarse, .fine = fine, .values = values, .morph = morph};
  *morph = (struct lod_morph){0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : weave(&w, exact, arena, scratch);
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

enum lod_status lod_overlay_part(const struct lod_overlay *overlay, const struct lod_mesh *coarse, const struct lod_mesh *fine,
                                 const struct lod_morph_values *values, const uint8_t *before, struct lod_arena *arena,
                                 struct lod_morph *morph) {
  struct overlay_part part;
  struct weaver w = {.overlay = overlay, .coarse = coarse, .fine = fine, .values = values, .part = &part, .morph = morph};
  *morph = (struct lod_morph){0};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  enum lod_status status = scratch == NULL ? LOD_MEMORY : overlay_part_create(overlay, coarse, before, scratch, &part);
  if (status == LOD_OK)
    status = weave(&w, true, arena, scratch);
  lod_arena_destroy(scratch);
  return status;
}
