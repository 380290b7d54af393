/* Paths on the finer surface as crossings of its edges, in order; where a path may leave a vertex. */
#include <string.h>

#include "core/mesh/overlay_private.h"

enum lod_status overlay_arrange(struct overlay_work *w) {
  size_t fine = 3 * (size_t)w->fine->triangle_count, coarse = 3 * (size_t)w->coarse->triangle_count;
  OVERLAY_TRY_ZERO(w->counts, w->arena, fine);
  OVERLAY_TRY_NEW(w->firsts, w->arena, fine);
  OVERLAY_TRY_NEW(w->along, w->arena, fine);
  OVERLAY_TRY_NEW(w->vertex_path, w->arena, w->fine->vertex_count);
  OVERLAY_TRY_ZERO(w->paths, w->arena, coarse);
  OVERLAY_TRY_NEW(w->fan_to, w->arena, w->c.fan_count);
  OVERLAY_TRY_NEW(w->fan_from, w->arena, w->f.fan_count);
  memset(w->firsts, 0xff, fine * sizeof *w->firsts);
  memset(w->along, 0xff, fine * sizeof *w->along);
  memset(w->vertex_path, 0xff, w->fine->vertex_count * sizeof *w->vertex_path);
  memset(w->fan_to, 0xff, w->c.fan_count * sizeof *w->fan_to);
  memset(w->fan_from, 0xff, w->f.fan_count * sizeof *w->fan_from);
  w->unused = LOD_NONE;
  return LOD_OK;
}

struct overlay_pattern overlay_pattern_of(const struct overlay_work *w, uint32_t t) {
  struct overlay_pattern p = {.apex = 3};
  for (uint32_t k = 0; k < 3; k++)
    p.sides[k] = overlay_count(w, 3 * t + k);
  if ((p.sides[0] | p.sides[1] | p.sides[2]) == 0)
    return p;
  for (uint32_t k = 0; k < 3; k++) {
    uint32_t opposite = p.sides[(k + 1) % 3], out = p.sides[k], in = p.sides[(k + 2) % 3];
    if (opposite > out + in) {
      p.apex = k;
      p.spokes = opposite - out - in;
      p.arcs[k] = 0;
      p.arcs[(k + 1) % 3] = out;
      p.arcs[(k + 2) % 3] = in;
      return p;
    }
    p.arcs[k] = (out + in - opposite) / 2;
  }
  return p;
}

uint32_t overlay_crossing_at(const struct overlay_work *w, uint32_t h, uint32_t index) {
  uint32_t edge = overlay_canonical(w->f.twin, h), x = w->firsts[edge];
  for (uint32_t i = edge == h ? index : w->counts[edge] - 1 - index; i > 0; i--)
    x = w->crossings[x].next;
  return x;
}

static enum lod_status new_crossing(struct overlay_work *w, uint32_t *crossing) {
  if (w->unused != LOD_NONE) {
    *crossing = w->unused;
    w->unused = w->crossings[w->unused].onward;
    return LOD_OK;
  }
  if (w->crossing_count == w->crossing_capacity) {
    uint32_t capacity = w->crossing_capacity < 1024 ? 1024 : 2 * w->crossing_capacity;
    struct overlay_crossing *larger;
    OVERLAY_TRY_NEW(larger, w->arena, capacity);
    if (w->crossing_count != 0)
      memcpy(larger, w->crossings, w->crossing_count * sizeof *larger);
    w->crossings = larger;
    w->crossing_capacity = capacity;
  }
  *crossing = w->crossing_count++;
  return LOD_OK;
}

enum lod_status overlay_cross(struct overlay_work *w, uint32_t path, uint32_t h, uint32_t gap, double share, uint32_t *crossing) {
  uint32_t edge = overlay_canonical(w->f.twin, h), *link = &w->firsts[edge], x;
  LOD_TRY(new_crossing(w, &x));
  for (uint32_t i = edge == h ? gap : w->counts[edge] - gap; i > 0; i--)
    link = &w->crossings[*link].next;
  w->crossings[x] = (struct overlay_crossing){
      .path = path, .edge = edge, .next = *link, .onward = LOD_NONE, .share = (float)(edge == h ? share : 1 - share)};
  *link = x;
  w->counts[edge]++;
  *crossing = x;
  return LOD_OK;
}

void overlay_rip(struct overlay_work *w, uint32_t p) {
  struct overlay_path *path = &w->paths[p];
  for (uint32_t i = 0; path->state == PATH_ALONG && i < path->count; i++) {
    uint32_t h = w->steps[path->first + i];
    w->along[overlay_canonical(w->f.twin, h)] = LOD_NONE;
    if (i > 0)
      w->vertex_path[lod_half_edge_start(w->fine, h)] = LOD_NONE;
  }
  for (uint32_t x = path->state == PATH_ALONG ? LOD_NONE : path->first, onward; x != LOD_NONE; x = onward) {
    struct overlay_crossing *crossing = &w->crossings[x];
    uint32_t *link = &w->firsts[crossing->edge];
    while (*link != x)
      link = &w->crossings[*link].next;
    *link = crossing->next;
    w->counts[crossing->edge]--;
    onward = crossing->onward;
    crossing->onward = w->unused;
    w->unused = x;
  }
  path->state = PATH_NONE;
  path->count = 0;
}

void overlay_join_fans(struct overlay_work *w, uint32_t coarse_corner, uint32_t fine_corner) {
  uint32_t c = w->c.fan_of[coarse_corner], f = w->f.fan_of[fine_corner];
  if (w->fan_to[c] == LOD_NONE && w->fan_from[f] == LOD_NONE) {
    w->fan_to[c] = f;
    w->fan_from[f] = c;
  }
}

/* ---- sectors ---- */

/* The path placed before the one that leaves along coarse half-edge e, going clockwise: as the half-edge of it that starts here. */
static uint32_t placed_before(const struct overlay_work *w, uint32_t e) {
  for (uint32_t at = e;;) {
    uint32_t twin = w->c.twin[at];
    if (twin == LOD_NONE)
      return LOD_NONE;
    at = lod_half_edge_next(twin);
    if (at == e)
      return LOD_NONE;
    if (w->paths[overlay_canonical(w->c.twin, at)].state != PATH_NONE)
      return at;
  }
}

static enum lod_status add_slot(struct overlay_work *w, struct overlay_sector *sector, uint32_t corner, uint32_t slot) {
  if (sector->count == sector->capacity) {
    uint32_t capacity = sector->capacity == 0 ? 32 : 2 * sector->capacity;
    struct overlay_slot *larger;
    OVERLAY_TRY_NEW(larger, w->arena, capacity);
    if (sector->count != 0)
      memcpy(larger, sector->slots, sector->count * sizeof *larger);
    sector->slots = larger;
    sector->capacity = capacity;
  }
  sector->slots[sector->count++] = (struct overlay_slot){corner, slot};
  return LOD_OK;
}

/* Adds slots counter-clockwise from slot `slot` of `corner` up to the next path. When that is the one that it began behind, the slots
 * before it in its own corner come last. */
static enum lod_status scan(struct overlay_work *w, uint32_t corner, uint32_t slot, enum overlay_ways ways, struct overlay_sector *sector) {
  for (uint32_t first = corner, stop = slot;;) {
    struct overlay_pattern p = overlay_pattern_of(w, corner / 3);
    uint32_t k = corner % 3, spokes = p.apex == k ? p.spokes : 0;
    if (p.arcs[k] == 0 && (p.apex == 3 || p.apex == k || ways == OVERLAY_WAYS_ALONG))
      LOD_TRY(add_slot(w, sector, corner, slot));
    else if (ways == OVERLAY_WAYS_ALL)
      LOD_TRY(add_slot(w, sector, corner, 0));
    if (slot < spokes)
      return LOD_OK;
    uint32_t side = lod_half_edge_previous(corner);
    if (w->along[overlay_canonical(w->f.twin, side)] != LOD_NONE)
      return LOD_OK;
    corner = w->f.twin[side];
    slot = 0;
    if (corner == LOD_NONE || (corner == first && stop == 0))
      return LOD_OK;
  }
}

static uint32_t spoke_index(const struct overlay_work *w, uint32_t corner, uint32_t path) {
  struct overlay_pattern p = overlay_pattern_of(w, corner / 3);
  uint32_t side = 3 * (corner / 3) + (corner + 1) % 3;
  uint32_t begin = overlay_slot_gap(&p, corner % 3, 0);
  for (uint32_t i = 0; i < p.spokes; i++)
    if (w->crossings[overlay_crossing_at(w, side, begin + i)].path == path)
      return i;
  return 0; /* not reached: a path has its spoke at each end */
}

enum lod_status overlay_find_sector(struct overlay_work *w, uint32_t p, int end, enum overlay_ways ways, struct overlay_sector *sector) {
  uint32_t e = end == 0 ? p : w->c.twin[p], before = placed_before(w, e);
  sector->count = 0;
  if (before != LOD_NONE) {
    uint32_t q = overlay_canonical(w->c.twin, before);
    const struct overlay_path *path = &w->paths[q];
    int its_end = before == q ? 0 : 1;
    if (path->state == PATH_CROSSING)
      return scan(w, path->corner[its_end], spoke_index(w, path->corner[its_end], q) + 1, ways, sector);
    uint32_t h = its_end == 0 ? w->steps[path->first] : w->f.twin[w->steps[path->first + path->count - 1]];
    return h == LOD_NONE ? LOD_OK : scan(w, h, 0, ways, sector);
  }
  uint32_t vertex = w->parents[lod_half_edge_start(w->coarse, e)], fan = w->fan_to[w->c.fan_of[e]], previous = LOD_NONE;
  for (uint32_t i = w->f.vertex_begin[vertex]; i < w->f.vertex_begin[vertex + 1]; i++) {
    uint32_t corner = w->f.vertex_corners[i], own = w->f.fan_of[corner];
    bool wanted = fan == LOD_NONE ? w->fan_from[own] == LOD_NONE : own == fan;
    if (wanted && own != previous)
      LOD_TRY(scan(w, corner, 0, ways, sector));
    previous = own;
  }
  return LOD_OK;
}

bool overlay_sector_has_edge(const struct overlay_work *w, const struct overlay_sector *sector, uint32_t h) {
  uint32_t edge = overlay_canonical(w->f.twin, h), twin = w->f.twin[h];
  if (w->counts[edge] != 0 || w->along[edge] != LOD_NONE)
    return false;
  /* Slot 0 of the corner that it begins, and the last slot of the corner that it ends. */
  bool after = false, before = twin == LOD_NONE;
  uint32_t right = twin == LOD_NONE ? LOD_NONE : lod_half_edge_next(twin);
  for (uint32_t i = 0; i < sector->count; i++) {
    const struct overlay_slot *s = &sector->slots[i];
    struct overlay_pattern p;
    after = after || (s->corner == h && s->slot == 0);
    if (s->corner != right)
      continue;
    p = overlay_pattern_of(w, right / 3);
    before = before || s->slot == (p.apex == right % 3 ? p.spokes : 0);
  }
  return after && before;
}
