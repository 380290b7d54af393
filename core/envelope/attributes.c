/* Attributes of a certified level, sampled from the source. */
#include "core/envelope/envelope.h"

#include <math.h>
#include <string.h>

#include "core/envelope/internal.h"

/* Weights of the corners of abc for a point p of it. */
static void barycentrics(struct lod_vec3 p, struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c, double weights[3]) {
  struct lod_vec3 ab = lod_vec3_subtract(b, a), ac = lod_vec3_subtract(c, a), ap = lod_vec3_subtract(p, a);
  double d00 = lod_vec3_dot(ab, ab), d01 = lod_vec3_dot(ab, ac), d11 = lod_vec3_dot(ac, ac);
  double d20 = lod_vec3_dot(ap, ab), d21 = lod_vec3_dot(ap, ac), denominator = d00 * d11 - d01 * d01;
  if (!(denominator > 0)) { /* without area: along the longer side */
    double t = d00 >= d11 ? (d00 > 0 ? d20 / d00 : 0) : d21 / d11;
    t = fmin(1, fmax(0, t));
    weights[0] = 1 - t;
    weights[1] = d00 >= d11 ? t : 0;
    weights[2] = d00 >= d11 ? 0 : t;
    return;
  }
  weights[1] = fmin(1, fmax(0, (d11 * d20 - d01 * d21) / denominator));
  weights[2] = fmin(1 - weights[1], fmax(0, (d00 * d21 - d01 * d20) / denominator));
  weights[0] = 1 - weights[1] - weights[2];
}

/* The source triangle nearest to p among those charged to the faces of one sector, on the sector's own patch. */
static uint32_t nearest_charged(const struct lod_collapser *c, const uint32_t *ring, uint32_t count, const uint8_t *sector, uint8_t which,
                                struct lod_vec3 p, struct lod_vec3 *nearest) {
  const struct lod_mesh *source = c->mesh;
  uint32_t best = LOD_NONE;
  double best_distance = INFINITY;
  for (uint32_t i = 0; i < count; i++) {
    if (sector[i] != which)
      continue;
    uint32_t face = ring[i];
    uint32_t charges = lod_certificate_charge_count(c->certificate, face);
    for (uint32_t j = 0; j <= charges; j++) {
      /* Behind the charges, for a face that has none on its patch: the triangle that it began as. */
      uint32_t t = j < charges ? lod_certificate_charge(c->certificate, face, j) : best == LOD_NONE ? face : LOD_NONE;
      if (t == LOD_NONE || c->patch[t] != c->patch[face])
        continue;
      const uint32_t *v = source->triangles[t];
      struct lod_vec3 q =
          lod_closest_on_triangle(p, lod_vec3_from_float(source->positions[v[0]]), lod_vec3_from_float(source->positions[v[1]]),
                                  lod_vec3_from_float(source->positions[v[2]]));
      double distance = lod_vec3_distance_squared(p, q);
      if (distance < best_distance || (distance == best_distance && t < best)) {
        best_distance = distance;
        best = t;
        *nearest = q;
      }
    }
  }
  return best;
}

static void sample(const struct lod_mesh *source, uint32_t t, struct lod_vec3 at, struct lod_mesh *to, uint32_t wedge) {
  const uint32_t *v = source->triangles[t], *w = source->corners[t];
  double weights[3];
  barycentrics(at, lod_vec3_from_float(source->positions[v[0]]), lod_vec3_from_float(source->positions[v[1]]),
               lod_vec3_from_float(source->positions[v[2]]), weights);
  if (to->normals != NULL) {
    struct lod_vec3 n = {0, 0, 0};
    for (int k = 0; k < 3; k++)
      n = lod_vec3_add_scaled(n, lod_vec3_from_float(source->normals[w[k]]), weights[k]);
    lod_vec3_to_float(lod_vec3_normalize(n), to->normals[wedge]);
  }
  for (int set = 0; set < LOD_UV_SETS; set++)
    for (int i = 0; i < 2 && to->uvs[set] != NULL; i++) {
      double value = 0;
      for (int k = 0; k < 3; k++)
        value += weights[k] * (double)source->uvs[set][w[k]][i];
      to->uvs[set][wedge][i] = (float)value;
    }
  for (int i = 0; i < 4 && to->colors != NULL; i++) {
    double value = 0;
    for (int k = 0; k < 3; k++)
      value += weights[k] * (double)source->colors[w[k]][i];
    to->colors[wedge][i] = (float)value;
  }
}

/* Numbers the sectors around a vertex: faces connected across edges that are no features. */
static uint8_t number_sectors(const struct lod_surface *s, const uint32_t *ring, uint32_t count, uint8_t *sector) {
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
  return sectors;
}

static bool allocate(const struct lod_mesh *source, struct lod_arena *arena, struct lod_mesh *m) {
  size_t most = (size_t)m->triangle_count * 3;
  bool ok = (m->corners = lod_arena_alloc(arena, m->triangle_count, sizeof *m->corners)) != NULL &&
            (m->wedge_vertex = LOD_NEW(arena, most, uint32_t)) != NULL;
  ok = ok && (source->normals == NULL || (m->normals = lod_arena_alloc(arena, most, sizeof *m->normals)) != NULL);
  ok = ok && (source->colors == NULL || (m->colors = lod_arena_alloc(arena, most, sizeof *m->colors)) != NULL);
  for (int k = 0; k < LOD_UV_SETS; k++)
    ok = ok && (source->uvs[k] == NULL || (m->uvs[k] = lod_arena_alloc(arena, most, sizeof *m->uvs[k])) != NULL);
  return ok;
}

/* A degenerate triangle that stayed keeps its corners' attributes, a wedge each. */
static void sample_kept(const struct lod_collapser *c, uint32_t t, struct lod_mesh *to, uint32_t triangle) {
  for (int k = 0; k < 3; k++) {
    uint32_t wedge = to->corners[triangle][k] = to->wedge_count++;
    to->wedge_vertex[wedge] = to->triangles[triangle][k];
    sample(c->mesh, t, lod_vec3_from_float(c->mesh->positions[c->mesh->triangles[t][k]]), to, wedge);
  }
}

enum { MAX_RING = 240 }; /* sector numbers are bytes */

enum lod_status lod_envelope_sample_attributes(const struct lod_collapser *c, struct lod_arena *arena, struct lod_mesh *result) {
  const struct lod_surface *s = &c->surface;
  if (c->mesh->wedge_count == 0)
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  uint32_t *face_to = scratch == NULL ? NULL : LOD_NEW(scratch, s->face_count, uint32_t);
  if (face_to == NULL || !allocate(c->mesh, arena, result)) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t f = 0, out = 0; f < s->face_count; f++)
    face_to[f] = s->face[f][0] == LOD_NONE ? LOD_NONE : out++;
  uint32_t vertex = 0;
  for (uint32_t v = 0; v < s->vertex_count; v++) {
    uint32_t count = s->ring_count[v];
    if (count == 0)
      continue;
    const uint32_t *ring = lod_surface_ring(s, v);
    /* A hub of hundreds of faces is sampled in runs; each run has wedges of its own. */
    for (uint32_t begin = 0; begin < count; begin += MAX_RING) {
      uint32_t run = count - begin < MAX_RING ? count - begin : MAX_RING;
      uint8_t sector[MAX_RING];
      uint8_t sectors = number_sectors(s, ring + begin, run, sector);
      for (uint8_t i = 0; i < sectors; i++) {
        struct lod_vec3 nearest = s->position[v];
        uint32_t t = nearest_charged(c, ring + begin, run, sector, i, s->position[v], &nearest);
        uint32_t wedge = result->wedge_count++;
        result->wedge_vertex[wedge] = vertex;
        sample(c->mesh, t, nearest, result, wedge);
        for (uint32_t j = 0; j < run; j++)
          if (sector[j] == i)
            result->corners[face_to[ring[begin + j]]][lod_surface_corner(s, ring[begin + j], v)] = wedge;
      }
    }
    vertex++;
  }
  for (uint32_t i = 0; i < c->kept_count; i++)
    sample_kept(c, c->kept[i], result, result->triangle_count - c->kept_count + i);
  lod_arena_destroy(scratch);
  return LOD_OK;
}

/* ---- how far they are from the source's ---- */

struct deviation {
  double distance; /* of the points compared; INFINITY = none yet */
  double uv[LOD_UV_SETS], normal_cosine;
};

static struct lod_vec3 mixed_normal(const struct lod_mesh *mesh, const uint32_t w[3], const double weights[3]) {
  struct lod_vec3 n = {0, 0, 0};
  for (int k = 0; k < 3; k++)
    n = lod_vec3_add_scaled(n, lod_vec3_from_float(mesh->normals[w[k]]), weights[k]);
  return lod_vec3_normalize(n);
}

static void corners_of(const struct lod_mesh *mesh, uint32_t t, struct lod_vec3 p[3]) {
  for (int k = 0; k < 3; k++)
    p[k] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
}

/* The centre of source triangle t against its nearest point on triangle u of the result, when that is nearer than what d holds. */
static void compare(const struct lod_mesh *source, uint32_t t, const struct lod_mesh *result, uint32_t u, struct deviation *d) {
  static const double kThirds[3] = {1.0 / 3, 1.0 / 3, 1.0 / 3};
  struct lod_vec3 p[3], q[3];
  corners_of(source, t, p);
  corners_of(result, u, q);
  struct lod_vec3 centre = lod_vec3_scale(lod_vec3_add(p[0], lod_vec3_add(p[1], p[2])), 1.0 / 3);
  struct lod_vec3 nearest = lod_closest_on_triangle(centre, q[0], q[1], q[2]);
  double distance = lod_vec3_distance_squared(centre, nearest), weights[3];
  if (distance >= d->distance)
    return;
  d->distance = distance;
  barycentrics(nearest, q[0], q[1], q[2], weights);
  const uint32_t *w = source->corners[t], *x = result->corners[u];
  for (int set = 0; set < LOD_UV_SETS; set++) {
    double difference[2] = {0, 0};
    for (int i = 0; i < 2 && source->uvs[set] != NULL; i++)
      for (int k = 0; k < 3; k++)
        difference[i] += kThirds[k] * (double)source->uvs[set][w[k]][i] - weights[k] * (double)result->uvs[set][x[k]][i];
    d->uv[set] = hypot(difference[0], difference[1]);
  }
  if (source->normals != NULL)
    d->normal_cosine = lod_vec3_dot(mixed_normal(source, w, kThirds), mixed_normal(result, x, weights));
}

enum lod_status lod_envelope_measure_attributes(const struct lod_collapser *c, struct lod_arena *arena, const struct lod_mesh *result,
                                                struct lod_envelope_report *report) {
  if (c->mesh->wedge_count == 0)
    return LOD_OK;
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct deviation *deviations = scratch == NULL ? NULL : LOD_NEW(scratch, c->mesh->triangle_count, struct deviation);
  if (deviations == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t t = 0; t < c->mesh->triangle_count; t++)
    deviations[t] = (struct deviation){.distance = INFINITY, .normal_cosine = 1};
  for (uint32_t f = 0, u = 0; f < c->surface.face_count; f++) {
    if (c->surface.face[f][0] == LOD_NONE)
      continue;
    for (uint32_t i = 0; i < lod_certificate_charge_count(c->certificate, f); i++) {
      uint32_t t = lod_certificate_charge(c->certificate, f, i);
      if (t != LOD_NONE && c->patch[t] == c->patch[f])
        compare(c->mesh, t, result, u, &deviations[t]);
    }
    u++;
  }
  for (uint32_t t = 0; t < c->mesh->triangle_count; t++) {
    for (int set = 0; set < LOD_UV_SETS; set++)
      report->uv[set] = fmax(report->uv[set], deviations[t].uv[set]);
    double degrees = acos(fmax(-1, fmin(1, deviations[t].normal_cosine))) * 57.29577951308232;
    report->normal_degrees = fmax(report->normal_degrees, degrees);
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}
