/* From cut connectivity to the finer level's own vertices: copies welded back, vertices of no triangle, segments, points, and which part
 * and material everything belongs to. */
#include <string.h>

#include "codec/stream/step.h"

struct models {
  struct lod_bit_model welded[2][2], near, is_new[4], same_group[2], thick;
  struct lod_number_model rank, end, group[2];
  struct lod_bit_model sign[2];
};

/* ---- welding ---- */

static void mark_border(const struct lod_connectivity *c, uint8_t *border) {
  for (uint32_t h = 0; h < 3 * c->triangle_count; h++)
    if (c->opposite[h] == LOD_NONE)
      border[c->triangles[h / 3][h % 3]] = border[c->triangles[h / 3][(h + 1) % 3]] = 1;
}

/* What a copy may be welded to: vertices beside those that its first triangle has already. */
struct welding {
  struct lod_adjacency corners; /* copy -> its 3 t + i in the cut mesh */
  uint32_t *creator;            /* copy -> the triangle that made it */
  uint32_t *final;              /* copy -> vertex */
  uint32_t *latest, *earlier;   /* vertex -> its last copy -> the one before, or LOD_NONE */
};
enum { NEAR_WELDS = 24 };

static enum lod_status open_welding(struct step *s, struct welding *w) {
  const struct lod_connectivity *c = &s->connectivity;
  const uint32_t half_edges = 3 * c->triangle_count;
  w->corners.first = LOD_NEW_ZERO(s->scratch, (size_t)c->vertex_count + 2, uint32_t);
  w->corners.list = LOD_NEW(s->scratch, half_edges, uint32_t);
  w->creator = LOD_NEW(s->scratch, c->vertex_count, uint32_t);
  w->latest = LOD_NEW(s->scratch, c->vertex_count, uint32_t);
  w->earlier = LOD_NEW(s->scratch, c->vertex_count, uint32_t);
  if (w->corners.first == NULL || w->corners.list == NULL || w->creator == NULL || w->latest == NULL || w->earlier == NULL)
    return LOD_MEMORY;
  for (uint32_t h = 0; h < half_edges; h++)
    w->corners.first[c->triangles[h / 3][h % 3] + 2]++;
  for (uint32_t v = 0; v < c->vertex_count; v++)
    w->corners.first[v + 2] += w->corners.first[v + 1];
  for (uint32_t h = half_edges; h-- > 0;)
    w->creator[c->triangles[h / 3][h % 3]] = h / 3;
  for (uint32_t h = 0; h < half_edges; h++)
    w->corners.list[w->corners.first[c->triangles[h / 3][h % 3] + 1]++] = h;
  memset(w->latest, 0xff, (size_t)c->vertex_count * sizeof *w->latest);
  return LOD_OK;
}

/* Vertices that lie across edges at the corners that copy v's first triangle shares with earlier ones. */
static uint32_t near_welds(const struct step *s, const struct welding *w, uint32_t v, uint32_t near[NEAR_WELDS]) {
  const struct lod_connectivity *c = &s->connectivity;
  const uint32_t *t = c->triangles[w->creator[v]];
  uint32_t count = 0, looked = 0;
  for (int i = 0; i < 3; i++) {
    if (t[i] >= v)
      continue;
    for (uint32_t copy = w->latest[w->final[t[i]]]; copy != LOD_NONE; copy = w->earlier[copy])
      for (uint32_t k = w->corners.first[copy]; k < w->corners.first[copy + 1]; k++)
        for (uint32_t e = 1; e < 3; e++) {
          const uint32_t h = w->corners.list[k], other = c->triangles[h / 3][(h % 3 + e) % 3];
          if (count == NEAR_WELDS || ++looked > 40 * NEAR_WELDS)
            return count;
          if (other >= v)
            continue;
          uint32_t vertex = w->final[other], known = 0;
          for (int n = 0; n < 3; n++) /* not one of the triangle's own */
            known += t[n] < v && w->final[t[n]] == vertex;
          for (uint32_t n = 0; n < count && known == 0; n++)
            known = near[n] == vertex;
          if (known == 0)
            near[count++] = vertex;
        }
  }
  return count;
}

static uint32_t code_weld(struct step *s, struct models *m, const struct welding *w, uint32_t v, uint32_t count, uint32_t known) {
  uint32_t near[NEAR_WELDS], rank = 0;
  const uint32_t nears = near_welds(s, w, v, near);
  while (rank < nears && near[rank] != known)
    rank++;
  if (nears > 0 && lod_coder_bit(&s->coder, &m->near, LOD_ADAPT, rank < nears)) {
    rank = lod_coder_number(&s->coder, &m->rank, rank);
    return rank < nears ? near[rank] : LOD_NONE;
  }
  int bits = 0;
  while (bits < 32 && (uint64_t)count > (uint64_t)1 << bits)
    bits++;
  return lod_coder_raw(&s->coder, known, bits);
}

static enum lod_status code_welds(struct step *s, struct models *m, uint32_t *final) {
  const struct lod_connectivity *c = &s->connectivity;
  const uint32_t welds = c->vertex_count - (s->header.vertices - s->loose);
  uint32_t count = 0, left = welds;
  bool again = false;
  struct welding w = {.final = final};
  uint8_t *border = welds != 0 ? LOD_NEW_ZERO(s->scratch, c->vertex_count, uint8_t) : NULL;
  if (welds != 0 && border == NULL)
    return LOD_MEMORY;
  if (welds != 0) {
    mark_border(c, border);
    LOD_TRY(open_welding(s, &w));
  }
  for (uint32_t v = 0; v < c->vertex_count; v++) {
    uint32_t fine = LOD_NONE, known = LOD_NONE;
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "welds");
    if (s->request != NULL) {
      fine = s->cut.uncut[c->source_vertices[v]];
      known = s->target[fine];
    }
    again = left > 0 && count > 0 && lod_coder_bit(&s->coder, &m->welded[border[v]][again], LOD_ADAPT, known != LOD_NONE);
    if (again) {
      final[v] = code_weld(s, m, &w, v, count, known);
      left--;
      if (final[v] >= count)
        return lod_step_bad(s, "welds");
    } else {
      if (count == s->header.vertices - s->loose)
        return lod_step_bad(s, "welds");
      if (s->request != NULL) {
        s->target[fine] = count;
        s->source[count] = fine;
      }
      s->component[count] = c->component[v];
      final[v] = count++;
    }
    if (welds != 0) {
      w.earlier[v] = w.latest[final[v]];
      w.latest[final[v]] = v;
    }
  }
  return count == s->header.vertices - s->loose ? LOD_OK : lod_step_bad(s, "welds");
}

/* ---- groups ---- */

static uint32_t code_group(struct step *s, struct models *m, int kind, uint32_t expected, uint32_t group) {
  if (s->groups.count < 2 || lod_coder_bit(&s->coder, &m->same_group[kind], LOD_ADAPT_SLOW, group == expected))
    return expected;
  return lod_coder_number(&s->coder, &m->group[kind], group);
}

static uint32_t pair_index(struct step *s, const uint32_t *parts, const uint32_t *materials, uint32_t i) {
  uint32_t part = parts == NULL ? 0 : parts[i], material = materials == NULL ? LOD_NONE : materials[i];
  for (uint32_t g = s->groups.count; g-- > 0;)
    if (s->groups.pairs[g][0] == part && s->groups.pairs[g][1] == material)
      return g;
  return LOD_NONE;
}

/* Encoding: the pairs that occur, in order of first use. Few: each is a primitive of the GLB. */
static enum lod_status collect_groups(struct step *s, uint32_t **index, const uint32_t *parts, const uint32_t *materials, uint32_t count) {
  *index = LOD_NEW(s->scratch, count, uint32_t);
  if (*index == NULL)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < count; i++) {
    uint32_t part = parts == NULL ? 0 : parts[i], material = materials == NULL ? LOD_NONE : materials[i],
             previous = i == 0 ? 0 : (*index)[i - 1];
    if (i > 0 && s->groups.pairs[previous][0] == part && s->groups.pairs[previous][1] == material) {
      (*index)[i] = previous;
      continue;
    }
    (*index)[i] = pair_index(s, parts, materials, i);
    if ((*index)[i] != LOD_NONE)
      continue;
    if ((s->groups.count & (s->groups.count - 1)) == 0) { /* room for the next power of two */
      uint32_t(*grown)[2] = lod_arena_alloc(s->scratch, 2 * (size_t)s->groups.count + 1, sizeof *grown);
      if (grown == NULL)
        return LOD_MEMORY;
      if (s->groups.count != 0)
        memcpy(grown, s->groups.pairs, s->groups.count * sizeof *grown);
      s->groups.pairs = grown;
    }
    (*index)[i] = s->groups.count;
    s->groups.pairs[s->groups.count][0] = part;
    s->groups.pairs[s->groups.count++][1] = material;
  }
  return LOD_OK;
}

static enum lod_status code_pairs(struct step *s, struct models *m) {
  struct lod_coder *c = &s->coder;
  struct lod_number_model *part = &m->group[0], *material = &m->group[1];
  s->groups.count = lod_coder_number(c, &m->end, s->groups.count);
  const uint64_t primitives = (uint64_t)s->header.triangles + s->header.edges + s->header.points;
  if (s->groups.count > primitives)
    return lod_step_bad(s, "materials");
  if (s->request == NULL)
    s->groups.pairs = lod_arena_alloc(s->scratch, s->groups.count, sizeof *s->groups.pairs);
  if (s->groups.pairs == NULL && s->groups.count != 0)
    return LOD_MEMORY;
  uint32_t previous[2] = {0, 0};
  for (uint32_t g = 0; g < s->groups.count; g++) { /* materials count from 1: 0 is the default */
    uint32_t *pair = s->groups.pairs[g];
    if (lod_coder_overrun(c))
      return lod_step_bad(s, "materials");
    previous[0] += (uint32_t)lod_coder_signed(c, part, &m->sign[0], (int32_t)(pair[0] - previous[0]));
    previous[1] += (uint32_t)lod_coder_signed(c, material, &m->sign[1], (int32_t)(pair[1] + 1 - previous[1]));
    pair[0] = previous[0];
    pair[1] = previous[1] - 1;
  }
  memset(m->group, 0, sizeof m->group);
  memset(m->sign, 0, sizeof m->sign);
  return LOD_OK;
}

static enum lod_status code_groups(struct step *s, struct models *m) {
  const struct lod_mesh *fine = s->request != NULL ? s->request->fine : NULL;
  if (fine != NULL) {
    LOD_TRY(collect_groups(s, &s->groups.triangles, fine->parts, fine->materials, fine->triangle_count));
    LOD_TRY(collect_groups(s, &s->groups.edges, fine->edge_parts, fine->edge_materials, fine->edge_count));
    LOD_TRY(collect_groups(s, &s->groups.points, fine->point_parts, fine->point_materials, fine->point_count));
  }
  LOD_TRY(code_pairs(s, m));
  uint32_t *group = LOD_NEW(s->arena, s->header.triangles, uint32_t), last = 0;
  if (group == NULL)
    return LOD_MEMORY;
  for (uint32_t t = 0; t < s->header.triangles; t++) {
    uint32_t gate = s->connectivity.opposite[3 * (size_t)t];
    uint32_t expected = gate != LOD_NONE && gate / 3 < t ? group[gate / 3] : last;
    last = code_group(s, m, 0, expected, fine != NULL ? s->groups.triangles[s->connectivity.source_half_edges[t] / 3] : 0);
    if (last >= s->groups.count)
      return lod_step_bad(s, "materials");
    group[t] = last;
  }
  s->groups.triangles = group;
  return LOD_OK;
}

/* ---- segments and points ---- */

static uint32_t code_end(struct step *s, struct models *m, int kind, uint32_t last, uint32_t *next_loose, uint32_t end) {
  const uint32_t unused = s->header.vertices - *next_loose;
  if (unused > 0 && lod_coder_bit(&s->coder, &m->is_new[kind], LOD_ADAPT, end == *next_loose))
    return (*next_loose)++;
  return last + (uint32_t)lod_coder_signed(&s->coder, &m->end, &m->sign[0], (int32_t)(end - last));
}

static float code_thickness(struct step *s, struct models *m, float last, float thickness) {
  if (lod_coder_bit(&s->coder, &m->thick, LOD_ADAPT, memcmp(&last, &thickness, sizeof last) == 0))
    return last;
  uint32_t bits;
  memcpy(&bits, &thickness, sizeof bits);
  bits = lod_coder_raw(&s->coder, bits, 32);
  memcpy(&thickness, &bits, sizeof bits);
  return thickness;
}

/* Encoding: loose vertices are numbered in the order in which segments, then points name them. */
static uint32_t number_loose(struct step *s, uint32_t fine, uint32_t *next) {
  if (s->target[fine] == LOD_NONE) {
    s->target[fine] = *next;
    s->source[*next] = fine;
    ++*next;
  }
  return s->target[fine];
}

static enum lod_status code_segments(struct step *s, struct models *m) {
  const struct lod_mesh *fine = s->request != NULL ? s->request->fine : NULL;
  uint32_t named = s->header.vertices - s->loose, next = named, last = 0, group = 0;
  float thickness = 0;
  for (uint32_t e = 0; e < s->header.edges; e++) {
    uint32_t ends[2] = {0, 0};
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "segments");
    for (int i = 0; i < 2; i++) {
      if (fine != NULL)
        ends[i] = number_loose(s, fine->edges[e][i], &named);
      s->edges[e][i] = last = code_end(s, m, i, last, &next, ends[i]);
      if (last >= s->header.vertices)
        return lod_step_bad(s, "segments");
    }
    thickness = code_thickness(s, m, thickness, fine == NULL || fine->edge_thickness == NULL ? 0 : fine->edge_thickness[e]);
    group = code_group(s, m, 1, group, fine != NULL ? s->groups.edges[e] : 0);
    if (group >= s->groups.count || s->edges[e][0] == s->edges[e][1] || !(thickness >= 0 && thickness <= 3e38f))
      return lod_step_bad(s, "segments");
    s->edge_thickness[e] = thickness;
    s->groups.edges[e] = group;
  }
  group = 0;
  thickness = 0;
  for (uint32_t p = 0; p < s->header.points; p++) {
    if (lod_coder_overrun(&s->coder))
      return lod_step_bad(s, "points");
    uint32_t point = fine != NULL ? number_loose(s, fine->points[p], &named) : 0;
    s->points[p] = last = code_end(s, m, 2, last, &next, point);
    thickness = code_thickness(s, m, thickness, fine == NULL || fine->point_thickness == NULL ? 0 : fine->point_thickness[p]);
    group = code_group(s, m, 1, group, fine != NULL ? s->groups.points[p] : 0);
    if (last >= s->header.vertices || group >= s->groups.count || !(thickness >= 0 && thickness <= 3e38f))
      return lod_step_bad(s, "points");
    s->point_thickness[p] = thickness;
    s->groups.points[p] = group;
  }
  return next == s->header.vertices ? LOD_OK : lod_step_bad(s, "segments and points");
}

/* ---- adjacency ---- */

static void count_to_first(uint32_t *first, uint32_t vertex_count) {
  uint32_t sum = 0;
  for (uint32_t v = 0; v <= vertex_count; v++) {
    uint32_t count = first[v];
    first[v] = sum;
    sum += count;
  }
}

/* The lists fill from first[v] up, and first moves back afterwards. */
static void shift_first(uint32_t *first, uint32_t vertex_count) {
  memmove(first + 1, first, (size_t)vertex_count * sizeof *first);
  first[0] = 0;
}

static enum lod_status build_adjacency(struct step *s) {
  const uint32_t vertices = s->header.vertices, triangles = s->header.triangles;
  const uint32_t *opposite = s->connectivity.opposite, *flat = triangles != 0 ? &s->triangles[0][0] : NULL;
  struct lod_adjacency *n = &s->adjacency, *k = &s->corners;
  size_t entries = 3 * (size_t)triangles + 2 * (size_t)s->header.edges;
  for (uint32_t h = 0; h < 3 * triangles; h++)
    entries += opposite[h] == LOD_NONE;
  if (entries >= LOD_NONE)
    return LOD_LIMIT;
  s->rim = LOD_NEW_ZERO(s->scratch, vertices, uint32_t);
  n->first = LOD_NEW_ZERO(s->scratch, (size_t)vertices + 1, uint32_t);
  k->first = LOD_NEW_ZERO(s->scratch, (size_t)vertices + 1, uint32_t);
  n->list = LOD_NEW(s->scratch, entries, uint32_t);
  k->list = LOD_NEW(s->scratch, 3 * (size_t)triangles, uint32_t);
  if (s->rim == NULL || n->first == NULL || k->first == NULL || n->list == NULL || k->list == NULL)
    return LOD_MEMORY;
  for (int pass = 0; pass < 3; pass++) { /* neighbours along the rim come first */
    for (uint32_t h = 0; h < 3 * triangles; h++) {
      uint32_t a = flat[h], b = flat[lod_half_edge_next(h)];
      const bool rim = opposite[h] == LOD_NONE;
      if (pass == 0) {
        n->first[a]++;
        k->first[a]++;
        n->first[b] += rim;
        s->rim[a] += rim;
        s->rim[b] += rim;
      } else if (pass == 1 && rim) {
        n->list[n->first[a]++] = b;
        n->list[n->first[b]++] = a;
      } else if (pass == 2) {
        k->list[k->first[a]++] = h;
        if (!rim)
          n->list[n->first[a]++] = b;
      }
    }
    for (uint32_t e = 0; e < s->header.edges; e++)
      for (int i = 0; i < 2; i++) {
        if (pass == 0)
          n->first[s->edges[e][i]]++;
        else if (pass == 2)
          n->list[n->first[s->edges[e][i]]++] = s->edges[e][1 - i];
      }
    if (pass == 0) {
      count_to_first(n->first, vertices);
      count_to_first(k->first, vertices);
    }
  }
  shift_first(n->first, vertices);
  shift_first(k->first, vertices);
  return LOD_OK;
}

/* ---- the whole ---- */

/* Encoding: vertices of the cut mesh at which components should begin: those that keep the first vertex of each of the base's components,
 * in the order in which locate.c asks for them. */
static enum lod_status find_starts(struct step *s, uint32_t **starts, uint32_t *count) {
  const struct step_base *b = &s->base;
  uint8_t *seen = LOD_NEW_ZERO(s->scratch, b->vertex_count, uint8_t);
  uint32_t *stack = LOD_NEW(s->scratch, b->vertex_count, uint32_t);
  uint32_t *copy = LOD_NEW(s->scratch, s->request->fine->vertex_count, uint32_t);
  *starts = LOD_NEW(s->scratch, b->vertex_count, uint32_t);
  *count = 0;
  if (seen == NULL || stack == NULL || copy == NULL || *starts == NULL)
    return LOD_MEMORY;
  memset(copy, 0xff, (size_t)s->request->fine->vertex_count * sizeof *copy);
  for (uint32_t v = s->cut.vertex_count; v-- > 0;)
    copy[s->cut.uncut[v]] = v;
  for (uint32_t v = 0; v < b->vertex_count; v++) {
    if (seen[v])
      continue;
    uint32_t kept = s->request->kept[b->order[v]], top = 0;
    if (kept != LOD_NONE && copy[kept] != LOD_NONE)
      (*starts)[(*count)++] = copy[kept];
    seen[v] = 1;
    for (stack[top++] = v; top > 0;) {
      uint32_t u = stack[--top];
      for (uint32_t i = b->adjacency.first[u]; i < b->adjacency.first[u + 1]; i++)
        if (!seen[b->adjacency.list[i]]) {
          seen[b->adjacency.list[i]] = 1;
          stack[top++] = b->adjacency.list[i];
        }
    }
  }
  return LOD_OK;
}

static enum lod_status allocate(struct step *s) {
  const struct lod_delta_header *h = &s->header;
  s->triangles = lod_arena_alloc(s->arena, h->triangles, sizeof *s->triangles);
  s->component = LOD_NEW(s->scratch, h->vertices, uint32_t);
  s->edges = lod_arena_alloc(s->arena, h->edges, sizeof *s->edges);
  s->edge_thickness = LOD_NEW(s->arena, h->edges, float);
  s->points = LOD_NEW(s->arena, h->points, uint32_t);
  s->point_thickness = LOD_NEW(s->arena, h->points, float);
  s->groups.edges = LOD_NEW(s->scratch, h->edges, uint32_t);
  s->groups.points = LOD_NEW(s->scratch, h->points, uint32_t);
  if (s->triangles == NULL || s->component == NULL || s->edges == NULL || s->edge_thickness == NULL || s->points == NULL ||
      s->point_thickness == NULL || s->groups.edges == NULL || s->groups.points == NULL)
    return LOD_MEMORY;
  memset(s->component, 0xff, (size_t)h->vertices * sizeof *s->component);
  if (s->request == NULL)
    return LOD_OK;
  s->source = LOD_NEW(s->arena, h->vertices, uint32_t);
  s->target = LOD_NEW(s->arena, h->vertices, uint32_t);
  if (s->source == NULL || s->target == NULL)
    return LOD_MEMORY;
  memset(s->target, 0xff, (size_t)h->vertices * sizeof *s->target);
  return LOD_OK;
}

enum lod_status lod_step_topology(struct step *s) {
  struct models *m = lod_coder_models(&s->coder, sizeof *m, s->scratch);
  uint32_t *starts = NULL, start_count = 0;
  if (m == NULL)
    return LOD_MEMORY;
  LOD_TRY(allocate(s));
  if (s->request != NULL)
    LOD_TRY(find_starts(s, &starts, &start_count));
  size_t before = s->coder.out_size;
  LOD_TRY(lod_connectivity_code(&s->coder, s->request != NULL ? &s->cut : NULL, starts, start_count, s->header.triangles, s->cut_vertices,
                                s->components, s->scratch, &s->connectivity, s->problem));
  if (s->connectivity.vertex_count != s->cut_vertices || s->connectivity.component_count != s->components)
    return lod_step_bad(s, "vertices");
  s->loose = lod_coder_number(&s->coder, &m->end, s->loose);
  memset(&m->end, 0, sizeof m->end);
  if (s->loose > s->header.vertices || s->cut_vertices < s->header.vertices - s->loose ||
      s->loose > 2 * (uint64_t)s->header.edges + s->header.points)
    return lod_step_bad(s, "vertices");
  uint32_t *final = LOD_NEW(s->scratch, s->cut_vertices, uint32_t);
  if (final == NULL)
    return LOD_MEMORY;
  LOD_TRY(code_welds(s, m, final));
  for (uint32_t h = 0; h < 3 * s->header.triangles; h++)
    s->triangles[h / 3][h % 3] = final[s->connectivity.triangles[h / 3][h % 3]];
  for (uint32_t t = 0; t < s->header.triangles; t++) {
    const uint32_t *v = s->triangles[t];
    if (v[0] == v[1] || v[1] == v[2] || v[2] == v[0])
      return lod_step_bad(s, "welds");
  }
  s->statistics->connectivity += 8.0 * (double)(s->coder.out_size - before);
  before = s->coder.out_size;
  LOD_TRY(code_groups(s, m));
  LOD_TRY(code_segments(s, m));
  s->statistics->groups += 8.0 * (double)(s->coder.out_size - before);
  return build_adjacency(s);
}
