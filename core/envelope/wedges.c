#include "core/envelope/wedges.h"

#include <math.h>
#include <string.h>

#include "core/envelope/backward.h"

enum { MOST_FAN = 64 };

/* ---- channels ---- */

static void add_group(struct lod_wedges *w, uint32_t count) {
  w->groups[w->group_count++] = (struct lod_channel_group){w->channels, count, INFINITY};
  w->channels += count;
}

static void find_groups(struct lod_wedges *w) {
  w->normals = -1;
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (w->source->uvs[set] != NULL)
      add_group(w, 2);
  if (w->source->normals != NULL) {
    w->normals = (int)w->group_count;
    add_group(w, 3);
  }
  if (w->source->colors != NULL)
    add_group(w, 4);
}

static double or_none(double bound) {
  return bound > 0 ? bound : INFINITY;
}

void lod_wedges_set_epsilon(struct lod_wedges *w, double epsilon) {
  uint32_t g = 0;
  for (int set = 0; set < LOD_UV_SETS; set++)
    if (w->source->uvs[set] != NULL)
      w->groups[g++].bound = fmin(or_none(w->bounds.uv), or_none(w->bounds.slip * w->density[set] * epsilon));
  if (w->source->normals != NULL) /* as the chord */
    w->groups[g++].bound = w->bounds.normal_degrees > 0 && w->bounds.normal_degrees < 180
                               ? 2 * sin(w->bounds.normal_degrees * 0.5 * 0.017453292519943295)
                               : INFINITY;
  if (w->source->colors != NULL)
    w->groups[g++].bound = or_none(w->bounds.color);
  w->bounded = false;
  for (g = 0; g < w->group_count; g++) {
    bool bounded = isfinite(w->groups[g].bound);
    w->bounded = w->bounded || bounded;
    for (uint32_t i = 0; i < w->groups[g].count; i++)
      w->weight[w->groups[g].first + i] = bounded ? 1 / (w->groups[g].bound * w->groups[g].bound) : 0;
  }
}

/* The root of the ratio of areas. */
static double density_of(const struct lod_mesh *m, int set) {
  double area = 0, uv_area = 0;
  for (uint32_t t = 0; t < m->triangle_count && m->uvs[set] != NULL; t++) {
    struct lod_vec3 p[3];
    for (int k = 0; k < 3; k++)
      p[k] = lod_vec3_from_float(m->positions[m->triangles[t][k]]);
    area += lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])));
    const float *a = m->uvs[set][m->corners[t][0]], *b = m->uvs[set][m->corners[t][1]], *c = m->uvs[set][m->corners[t][2]];
    uv_area +=
        fabs(((double)b[0] - (double)a[0]) * ((double)c[1] - (double)a[1]) - ((double)b[1] - (double)a[1]) * ((double)c[0] - (double)a[0]));
  }
  return area > 0 ? sqrt(uv_area / area) : 0;
}

static void read_source(struct lod_wedges *w) {
  const struct lod_mesh *m = w->source;
  for (uint32_t i = 0; i < m->wedge_count; i++) {
    double *to = w->of_source + (size_t)i * w->channels;
    for (int set = 0; set < LOD_UV_SETS; set++)
      for (int k = 0; k < 2 && m->uvs[set] != NULL; k++)
        *to++ = (double)m->uvs[set][i][k];
    for (int k = 0; k < 3 && m->normals != NULL; k++)
      *to++ = (double)m->normals[i][k];
    for (int k = 0; k < 4 && m->colors != NULL; k++)
      *to++ = (double)m->colors[i][k];
  }
}

static void tidy(const struct lod_wedges *w, double *value) {
  if (w->normals >= 0) {
    double *n = value + w->groups[w->normals].first, length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int k = 0; k < 3 && length > 0; k++)
      n[k] /= length;
  }
  if (w->source->colors != NULL)
    for (uint32_t i = w->channels - 4; i < w->channels; i++)
      value[i] = fmin(1, fmax(0, value[i]));
}

/* ---- the beginning ---- */

static uint32_t new_wedge(struct lod_wedges *w, uint32_t initial) {
  w->initial[w->count] = initial;
  memcpy(w->value + (size_t)w->count * w->channels, w->of_source + (size_t)initial * w->channels, w->channels * sizeof *w->value);
  return w->count++;
}

static uint32_t source_wedge(const struct lod_wedges *w, const struct lod_surface *s, uint32_t f, uint32_t v) {
  return w->source->corners[f][lod_surface_corner(s, f, v)];
}

/* Every wedge of the source by itself. */
static void keep_apart(struct lod_wedges *w, const struct lod_surface *s, uint32_t v) {
  const uint32_t *ring = lod_surface_ring(s, v);
  for (uint32_t i = 0; i < s->ring_count[v]; i++) {
    uint32_t initial = source_wedge(w, s, ring[i], v), j = 0;
    while (j < i && source_wedge(w, s, ring[j], v) != initial)
      j++;
    w->corner[ring[i]][lod_surface_corner(s, ring[i], v)] =
        j < i ? w->corner[ring[j]][lod_surface_corner(s, ring[j], v)] : new_wedge(w, initial);
  }
}

static void number_sectors(const struct lod_surface *s, const uint32_t *ring, uint32_t count, uint8_t *sector) {
  uint8_t sectors = 0;
  memset(sector, 0xff, count);
  for (uint32_t i = 0; i < count; i++) {
    if (sector[i] != 0xff)
      continue;
    sector[i] = sectors;
    for (bool grown = true; grown;) {
      grown = false;
      for (uint32_t j = 0; j < count; j++)
        for (uint32_t k = 0; k < count && sector[j] == 0xff; k++)
          if (sector[k] == sectors && lod_surface_smooth_neighbours(s, ring[k], ring[j])) {
            sector[j] = sectors;
            grown = true;
          }
    }
    sectors++;
  }
}

static bool within(const struct lod_wedges *w, const double *x, const double *y, double share) {
  for (uint32_t g = 0; g < w->group_count; g++) /* UV of a sector are the same on both sides: else there is a seam */
    if (w->groups[g].count != 2 &&
        !(lod_group_distance_squared(&w->groups[g], x, y) <= share * share * w->groups[g].bound * w->groups[g].bound))
      return false;
  return true;
}

/* A sector's wedges become one, the mean; false when they are too far apart for that in normals or colours, whose bounds do not grow. */
static bool join_sector(struct lod_wedges *w, const struct lod_surface *s, uint32_t v, const uint8_t *sector, uint8_t which) {
  const uint32_t *ring = lod_surface_ring(s, v);
  double mean[LOD_MOST_CHANNELS] = {0};
  uint32_t members = 0, first = LOD_NONE;
  bool same = true;
  for (uint32_t i = 0; i < s->ring_count[v]; i++) {
    if (sector[i] != which)
      continue;
    uint32_t initial = source_wedge(w, s, ring[i], v);
    first = first == LOD_NONE ? initial : first;
    same = same && initial == first;
    members++;
    for (uint32_t c = 0; c < w->channels; c++)
      mean[c] += w->of_source[(size_t)initial * w->channels + c];
  }
  for (uint32_t c = 0; c < w->channels; c++)
    mean[c] /= members;
  tidy(w, mean);
  for (uint32_t i = 0; i < s->ring_count[v] && !same; i++)
    if (sector[i] == which && !within(w, mean, w->of_source + (size_t)source_wedge(w, s, ring[i], v) * w->channels, 0.5))
      return false;
  uint32_t wedge = new_wedge(w, first);
  if (!same)
    memcpy(w->value + (size_t)wedge * w->channels, mean, w->channels * sizeof *mean);
  for (uint32_t i = 0; i < s->ring_count[v]; i++)
    if (sector[i] == which)
      w->corner[ring[i]][lod_surface_corner(s, ring[i], v)] = wedge;
  return true;
}

static void begin_vertex(struct lod_wedges *w, struct lod_surface *s, uint32_t v) {
  uint8_t sector[MOST_FAN];
  uint32_t count = s->ring_count[v], before = w->count;
  bool joined = count <= MOST_FAN;
  if (joined) {
    number_sectors(s, lod_surface_ring(s, v), count, sector);
    for (uint8_t which = 0; joined; which++) {
      bool any = false;
      for (uint32_t i = 0; i < count; i++)
        any = any || sector[i] == which;
      if (!any)
        break;
      joined = join_sector(w, s, v, sector, which);
    }
  }
  if (joined)
    return;
  w->count = before;
  keep_apart(w, s, v);
  s->kind[v] = LOD_VERTEX_CORNER;
}

static struct lod_linear *linear_of(const struct lod_wedges *w, uint32_t wedge) {
  return w->linear + (size_t)wedge * w->channels;
}

static void add_linear(const struct lod_wedges *w, struct lod_linear *to, const struct lod_linear *from) {
  for (uint32_t c = 0; c < w->channels; c++) {
    to[c].gradient = lod_vec3_add(to[c].gradient, from[c].gradient);
    to[c].offset += from[c].offset;
  }
}

static struct lod_quadric *energy_of(const struct lod_wedges *w, uint32_t wedge) {
  return w->energy + (size_t)wedge * w->group_count;
}

static void add(struct lod_wedges *w, uint32_t wedge, const struct lod_quadric *energy, const struct lod_linear *linear) {
  for (uint32_t g = 0; g < w->group_count; g++)
    lod_quadric_add(&energy_of(w, wedge)[g], &energy[g]);
  add_linear(w, linear_of(w, wedge), linear);
}

/* A triangle's channels are linear over it: gradient and offset, weighted by a third of its area, for each of its wedges. */
static void add_triangle(struct lod_wedges *w, const struct lod_surface *s, uint32_t f) {
  struct lod_vec3 p[3];
  const double *value[3];
  for (int k = 0; k < 3; k++) {
    p[k] = s->position[s->face[f][k]];
    value[k] = w->of_source + (size_t)w->source->corners[f][k] * w->channels;
  }
  struct lod_vec3 ab = lod_vec3_subtract(p[1], p[0]), ac = lod_vec3_subtract(p[2], p[0]);
  double d00 = lod_vec3_dot(ab, ab), d01 = lod_vec3_dot(ab, ac), d11 = lod_vec3_dot(ac, ac), det = d00 * d11 - d01 * d01;
  double area = 0.5 * sqrt(fmax(0, det));
  if (!(det > 1e-12 * d00 * d11))
    return;
  struct lod_quadric energy[LOD_MOST_GROUPS] = {{0}};
  struct lod_linear linear[LOD_MOST_CHANNELS];
  for (uint32_t g = 0; g < w->group_count; g++) {
    for (uint32_t c = w->groups[g].first; c < w->groups[g].first + w->groups[g].count; c++) {
      double x = value[1][c] - value[0][c], y = value[2][c] - value[0][c];
      struct lod_vec3 gradient = lod_vec3_add_scaled(lod_vec3_scale(ab, (d11 * x - d01 * y) / det), ac, (d00 * y - d01 * x) / det);
      double offset = value[0][c] - lod_vec3_dot(gradient, p[0]);
      lod_quadric_add_plane(&energy[g], gradient, offset, area / 3);
      linear[c] = (struct lod_linear){lod_vec3_scale(gradient, area / 3), offset * area / 3};
    }
    energy[g].weight = area / 3;
  }
  for (int k = 0; k < 3; k++)
    add(w, w->corner[f][k], energy, linear);
}

enum lod_status lod_wedges_create(const struct lod_mesh *source, struct lod_surface *s, const struct lod_attribute_bounds *bounds,
                                  struct lod_arena *arena, struct lod_wedges *w) {
  *w = (struct lod_wedges){.source = source};
  if (source->wedge_count == 0)
    return LOD_OK;
  find_groups(w);
  if (w->channels == 0)
    return LOD_OK;
  w->bounds = bounds == NULL ? (struct lod_attribute_bounds){0, 0, 0, 0} : *bounds;
  for (int set = 0; set < LOD_UV_SETS; set++)
    w->density[set] = density_of(source, set);
  lod_wedges_set_epsilon(w, 1);
  size_t most = 3 * (size_t)s->live_faces;
  w->of_source = LOD_NEW(arena, (size_t)source->wedge_count * w->channels, double);
  w->corner = lod_arena_alloc(arena, s->face_count, sizeof *w->corner);
  w->initial = LOD_NEW(arena, most, uint32_t);
  w->value = LOD_NEW(arena, most * w->channels, double);
  if (w->of_source == NULL || w->corner == NULL || w->initial == NULL || w->value == NULL)
    return LOD_MEMORY;
  read_source(w);
  for (uint32_t v = 0; v < s->vertex_count; v++)
    if (s->ring_count[v] != 0)
      begin_vertex(w, s, v);
  w->energy = LOD_NEW_ZERO(arena, (size_t)w->count * w->group_count, struct lod_quadric);
  w->linear = LOD_NEW_ZERO(arena, (size_t)w->count * w->channels, struct lod_linear);
  if (w->energy == NULL || w->linear == NULL)
    return LOD_MEMORY;
  for (uint32_t f = 0; f < s->face_count; f++)
    if (s->face[f][0] != LOD_NONE)
      add_triangle(w, s, f);
  return LOD_OK;
}

/* ---- a change ---- */

static double *value_of(const struct lod_wedges *w, uint32_t wedge) {
  return w->value + (size_t)wedge * w->channels;
}

/* The values that fit the triangles of both wedges best at a place. */
static void solve(const struct lod_wedges *w, uint32_t one, uint32_t other, struct lod_vec3 to, double *value) {
  const struct lod_linear *q = linear_of(w, one), *r = other == LOD_NONE ? NULL : linear_of(w, other);
  double area = energy_of(w, one)->weight + (r == NULL ? 0 : energy_of(w, other)->weight);
  for (uint32_t c = 0; c < w->channels; c++) {
    double sum = lod_vec3_dot(q[c].gradient, to) + q[c].offset;
    sum += r == NULL ? 0 : lod_vec3_dot(r[c].gradient, to) + r[c].offset;
    value[c] = area > 0 ? sum / area : value_of(w, one)[c];
  }
  tidy(w, value);
}

struct pair {
  uint32_t a, b; /* wedges; a LOD_NONE: b alone moves */
};

/* Which wedge of b goes on for which of a: those of the faces on edge (a, b). */
static uint32_t find_pairs(const struct lod_wedges *w, const struct lod_surface *s, uint32_t a, uint32_t b, struct pair pairs[2]) {
  uint32_t count = 0;
  const uint32_t *ring = lod_surface_ring(s, a == LOD_NONE ? b : a);
  for (uint32_t i = 0; i < s->ring_count[a == LOD_NONE ? b : a]; i++) {
    uint32_t f = ring[i];
    const uint32_t *v = s->face[f];
    if (v[0] != b && v[1] != b && v[2] != b)
      continue;
    struct pair pair = {a == LOD_NONE ? LOD_NONE : w->corner[f][lod_surface_corner(s, f, a)], w->corner[f][lod_surface_corner(s, f, b)]};
    bool known = false;
    for (uint32_t j = 0; j < count; j++)
      known = known || (a == LOD_NONE ? pairs[j].b == pair.b : pairs[j].a == pair.a);
    if (known)
      continue;
    if (count == 2)
      return 3;
    pairs[count++] = pair;
  }
  return count;
}

static bool same_place(struct lod_vec3 p, struct lod_vec3 q) {
  return p.x == q.x && p.y == q.y && p.z == q.z;
}

/* Another wedge that goes to `to`. from: of a, which it takes in, or LOD_NONE; of_a: it is a's itself. */
static bool add_placed(const struct lod_wedges *w, const struct lod_surface *s, uint32_t a, uint32_t b, uint32_t wedge, uint32_t from,
                       bool of_a, struct lod_vec3 to, struct lod_change *change) {
  if (change->placed_count == LOD_MOST_PLACED)
    return false;
  struct lod_placed_wedge *placed = &change->placed[change->placed_count++];
  bool goes = a != LOD_NONE && same_place(to, s->position[a]), stays = same_place(to, s->position[b]);
  *placed = (struct lod_placed_wedge){.wedge = wedge, .from = from, .moved = of_a ? !goes : !stays};
  if (placed->moved && goes && from != LOD_NONE)
    memcpy(placed->value, value_of(w, from), w->channels * sizeof *placed->value);
  else if (placed->moved)
    solve(w, wedge, from, to, placed->value);
  return true;
}

static bool is_placed(const struct lod_change *change, uint32_t wedge) {
  for (uint32_t i = 0; i < change->placed_count; i++)
    if (change->placed[i].wedge == wedge)
      return true;
  return false;
}

/* Where the faces on edge (a, b) do not say what becomes of a wedge of a junction, it goes on by itself. */
bool lod_wedges_place(const struct lod_wedges *w, const struct lod_surface *s, uint32_t a, uint32_t b, struct lod_vec3 to,
                      struct lod_change *change, struct lod_candidate *faces) {
  struct pair pairs[2];
  uint32_t count = find_pairs(w, s, a, b, pairs);
  if (count > 2)
    return false;
  bool junction = a != LOD_NONE && s->kind[a] == LOD_VERTEX_JUNCTION;
  change->placed_count = 0;
  for (uint32_t i = 0; i < count; i++)
    if (!add_placed(w, s, a, b, pairs[i].b, pairs[i].a, false, to, change))
      return false;
  for (uint32_t k = 0; k < change->fresh_count; k++)
    for (int corner = 0; corner < 3; corner++) {
      uint32_t wedge = w->corner[faces[k].face][corner], v = faces[k].vertex[corner];
      uint32_t i = v == a ? 0 : count;
      while (i < count && pairs[i].a != wedge)
        i++;
      if (v == a && i < count)
        wedge = pairs[i].b;
      else if ((v == a && !junction) ||
               ((v == a || v == b) && !is_placed(change, wedge) && !add_placed(w, s, a, b, wedge, LOD_NONE, v == a, to, change)))
        return false;
      faces[k].wedge[corner] = wedge;
    }
  return true;
}

void lod_wedges_commit(struct lod_wedges *w, const struct lod_change *change) {
  for (uint32_t k = 0; k < change->fresh_count && w->channels != 0; k++)
    memcpy(w->corner[change->faces[k].face], change->faces[k].wedge, sizeof *w->corner);
  for (uint32_t i = 0; i < change->placed_count; i++) {
    const struct lod_placed_wedge *placed = &change->placed[i];
    if (placed->moved)
      memcpy(value_of(w, placed->wedge), placed->value, w->channels * sizeof *placed->value);
    if (placed->from == LOD_NONE || placed->from == placed->wedge)
      continue;
    add(w, placed->wedge, energy_of(w, placed->from), linear_of(w, placed->from));
  }
}

/* ---- energy ---- */

/* Of both wedges together: the residual of the best values at p, as a quadric. Its weight is the area. */
static struct lod_quadric residual(const struct lod_wedges *w, const struct pair *pair) {
  struct lod_quadric sum = {0};
  const struct lod_linear *l = linear_of(w, pair->a), *m = linear_of(w, pair->b);
  double area = energy_of(w, pair->a)->weight + energy_of(w, pair->b)->weight;
  for (uint32_t g = 0; g < w->group_count && area > 0; g++) {
    double weight = w->weight[w->groups[g].first];
    if (!(weight > 0))
      continue;
    struct lod_quadric q = energy_of(w, pair->b)[g];
    lod_quadric_add(&q, &energy_of(w, pair->a)[g]);
    for (uint32_t c = w->groups[g].first; c < w->groups[g].first + w->groups[g].count; c++)
      lod_quadric_add_plane(&q, lod_vec3_add(l[c].gradient, m[c].gradient), l[c].offset + m[c].offset, -1 / area);
    double *from = &q.a00, *to = &sum.a00;
    for (int k = 0; k < 10; k++)
      to[k] += weight * from[k];
  }
  sum.weight = area;
  return sum;
}

double lod_wedges_cost(const struct lod_wedges *w, const struct lod_surface *s, uint32_t a, uint32_t b, struct lod_vec3 to) {
  struct pair pairs[2];
  uint32_t count = w->bounded ? find_pairs(w, s, a, b, pairs) : 0;
  double cost = 0;
  bool stays = same_place(to, s->position[b]), goes = same_place(to, s->position[a]);
  for (uint32_t i = 0; i < count && count <= 2; i++) {
    struct lod_quadric q = residual(w, &pairs[i]);
    cost += fmax(0, lod_quadric_value(&q, to));
    if (!stays && !goes)
      continue;
    double best[LOD_MOST_CHANNELS];
    solve(w, pairs[i].b, pairs[i].a, to, best);
    const double *value = value_of(w, stays ? pairs[i].b : pairs[i].a);
    for (uint32_t c = 0; c < w->channels; c++)
      cost += q.weight * w->weight[c] * (value[c] - best[c]) * (value[c] - best[c]);
  }
  return cost;
}

void lod_wedges_add_quadric(const struct lod_wedges *w, const struct lod_surface *s, uint32_t a, uint32_t b, double scale,
                            struct lod_quadric *quadric) {
  struct pair pairs[2];
  uint32_t count = w->bounded ? find_pairs(w, s, a, b, pairs) : 0;
  for (uint32_t i = 0; i < count && count <= 2; i++) {
    struct lod_quadric q = residual(w, &pairs[i]);
    double *from = &q.a00, *to = &quadric->a00;
    for (int k = 0; k < 10; k++)
      to[k] += scale * from[k];
  }
}
