/* The order of collapses: a heap of edges by the quadric error at their best place. */
#include <math.h>
#include <string.h>

#include "core/envelope/internal.h"
#include "core/envelope/quadric.h"

enum { WIDTH = 4 }; /* of the heap: half as deep as a binary one */

static bool before(const struct lod_queue_entry *x, const struct lod_queue_entry *y) {
  if (x->cost != y->cost)
    return x->cost < y->cost;
  return x->a != y->a ? x->a < y->a : x->b < y->b;
}

static enum lod_status push(struct lod_collapser *c, struct lod_queue_entry entry) {
  if (c->heap_count == c->heap_capacity) {
    size_t capacity = c->heap_capacity == 0 ? 4096 : 2 * c->heap_capacity;
    struct lod_queue_entry *grown = LOD_NEW(c->arena, capacity, struct lod_queue_entry);
    if (grown == NULL)
      return LOD_MEMORY;
    if (c->heap_count != 0)
      memcpy(grown, c->heap, c->heap_count * sizeof *grown);
    c->heap = grown;
    c->heap_capacity = capacity;
  }
  size_t i = c->heap_count++;
  while (i > 0 && before(&entry, &c->heap[(i - 1) / WIDTH])) {
    c->heap[i] = c->heap[(i - 1) / WIDTH];
    i = (i - 1) / WIDTH;
  }
  c->heap[i] = entry;
  return LOD_OK;
}

struct lod_queue_entry lod_queue_pop(struct lod_collapser *c) {
  struct lod_queue_entry top = c->heap[0], last = c->heap[--c->heap_count];
  size_t i = 0, count = c->heap_count;
  for (;;) {
    size_t first = WIDTH * i + 1, child = first, end = first + WIDTH < count ? first + WIDTH : count;
    if (first >= count)
      break;
    for (size_t j = first + 1; j < end; j++)
      child = before(&c->heap[j], &c->heap[child]) ? j : child;
    if (!before(&c->heap[child], &last))
      break;
    c->heap[i] = c->heap[child];
    i = child;
  }
  if (count > 0)
    c->heap[i] = last;
  return top;
}

static struct lod_vec3 rounded(struct lod_vec3 p) {
  return lod_vec3_make((double)(float)p.x, (double)(float)p.y, (double)(float)p.z);
}

int lod_collapser_placements(const struct lod_collapser *c, uint32_t a, uint32_t b, bool b_stays, struct lod_vec3 place[4],
                             double cost[4]) {
  struct lod_vec3 pa = c->surface.position[a], pb = c->surface.position[b];
  struct lod_quadric q = c->quadric[a];
  lod_quadric_add(&q, &c->quadric[b]);
  struct lod_quadric geometry = q;
  lod_wedges_add_quadric(&c->wedges, &c->surface, a, b, c->epsilon * c->epsilon, &q);
  int count = 0;
  place[count++] = pb;
  if (!b_stays) {
    place[count++] = pa;
    if (!c->settings.vertex_subset) {
      struct lod_vec3 middle = lod_vec3_scale(lod_vec3_add(pa, pb), 0.5), best;
      place[count++] = rounded(middle);
      double reach = 4 * lod_vec3_distance_squared(pa, pb);
      if (lod_quadric_minimum(&q, middle, &best) && lod_vec3_distance_squared(best, middle) <= reach)
        place[count++] = rounded(best);
    }
  }
  for (int i = 0; i < count; i++)
    cost[i] = fmax(0, lod_quadric_value(&geometry, place[i])) +
              c->epsilon * c->epsilon * lod_wedges_cost(&c->wedges, &c->surface, a, b, place[i]);
  for (int i = 1; i < count; i++)
    for (int j = i; j > 0 && cost[j] < cost[j - 1]; j--) {
      double t = cost[j];
      struct lod_vec3 p = place[j];
      cost[j] = cost[j - 1];
      place[j] = place[j - 1];
      cost[j - 1] = t;
      place[j - 1] = p;
    }
  return count;
}

enum lod_status lod_queue_push_edge(struct lod_collapser *c, uint32_t a, uint32_t b) {
  const struct lod_surface *s = &c->surface;
  if (s->kind[a] > s->kind[b] || (s->kind[a] == s->kind[b] && a > b)) { /* a is the one that may vanish */
    uint32_t t = a;
    a = b;
    b = t;
  }
  if (s->kind[a] == LOD_VERTEX_CORNER)
    return LOD_OK;
  struct lod_vec3 place[4];
  double cost[4];
  lod_collapser_placements(c, a, b, s->kind[a] != s->kind[b], place, cost);
  if (cost[0] > c->gate * (c->quadric[a].weight + c->quadric[b].weight))
    return LOD_OK; /* not to be tried before one of its ends changes, and then it comes here again */
  /* Among edges of equal error (flat regions) short ones first: they keep triangles round. */
  double length = lod_vec3_distance_squared(s->position[a], s->position[b]);
  return push(c, (struct lod_queue_entry){cost[0] + 1e-9 * length * length, a, b, c->stamp[a], c->stamp[b]});
}

enum lod_status lod_queue_push_all(struct lod_collapser *c) {
  c->heap_count = 0;
  for (uint32_t f = 0; f < c->surface.face_count; f++)
    for (int k = 0; k < 3 && c->surface.face[f][0] != LOD_NONE; k++) {
      uint32_t a = c->surface.face[f][k], b = c->surface.face[f][(k + 1) % 3];
      if (a < b || (c->surface.feature[f] >> k & 1)) /* boundary edges have one face only */
        LOD_TRY(lod_queue_push_edge(c, a, b));
    }
  return LOD_OK;
}
