/* Vertices of the finest level move over the source towards the middle of their neighbours: what repulsion did to points is done again to
 * triangles, whose shape is what counts (after Alliez, Colin de Verdiere, Devillers, Isenburg. Isotropic Surface Remeshing. 2003: each to
 * the weighted centroid of its star). A move that makes the worst triangle around worse, or misses the source by more, is taken back. */
#include <math.h>

#include "core/retile/internal.h"

struct star_facts {
  double shape; /* least 2r/R */
  double error; /* largest match_error of what lies there; not looked at below `enough` */
  bool upright; /* no triangle looks away from the source at its corners */
};

static double shape_of(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  double x = lod_vec3_distance(a, b), y = lod_vec3_distance(b, c), z = lod_vec3_distance(c, a), product = x * y * z;
  return product > 0 ? fmax(0, (y + z - x) * (z + x - y) * (x + y - z) / product) : 0;
}

static struct star_facts look(struct tiling *t, uint32_t v, double enough) {
  struct star_facts facts = {1, enough, true};
  uint32_t begin = t->corner[v], h = begin;
  do {
    const uint32_t *c = t->faces[h / 3];
    struct lod_vec3 a = t->positions[c[0]], b = t->positions[c[1]], d = t->positions[c[2]];
    struct lod_vec3 n = lod_vec3_normalize(lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(d, a)));
    facts.shape = fmin(facts.shape, shape_of(a, b, d));
    facts.upright = facts.upright && lod_vec3_dot(n, t->normals[v]) > 0.5;
    facts.error = fmax(facts.error, match_known(t, h / 3, enough));
    h = t->twin[retile_previous(h)];
  } while (h != begin);
  return facts;
}

/* Inside the surface, of no line. */
static bool free_to_move(const struct tiling *t, uint32_t v) {
  uint32_t begin = t->corner[v], h = begin;
  do {
    if (t->marks[h] != 0 || t->twin[retile_previous(h)] == LOD_NONE)
      return false;
    h = t->twin[retile_previous(h)];
  } while (h != begin);
  return true;
}

static void forget_star(struct tiling *t, uint32_t v) {
  uint32_t begin = t->corner[v], h = begin;
  do {
    match_forget(t, h / 3);
    h = t->twin[retile_previous(h)];
  } while (h != begin);
}

static bool settle_one(struct tiling *t, uint32_t v, double enough) {
  struct lod_vec3 sum = {0, 0, 0};
  double weight = 0;
  uint32_t begin = t->corner[v], h = begin;
  do {
    const uint32_t *c = t->faces[h / 3];
    struct lod_vec3 a = t->positions[c[0]], b = t->positions[c[1]], d = t->positions[c[2]];
    double spacing = 0;
    for (int k = 0; k < 3; k++)
      spacing += sheet_spacing(t->sheet, &t->points[c[k]]) / 3;
    double w = lod_vec3_length(lod_vec3_cross(lod_vec3_subtract(b, a), lod_vec3_subtract(d, a))) / (spacing * spacing);
    sum = lod_vec3_add_scaled(sum, lod_vec3_add(a, lod_vec3_add(b, d)), w / 3);
    weight += w;
    h = t->twin[retile_previous(h)];
  } while (h != begin);
  if (!(weight > 0))
    return false;
  struct star_facts before = look(t, v, enough);
  struct cloud_point moved = {.at = t->points[v]};
  struct lod_vec3 old_position = t->positions[v], old_normal = t->normals[v];
  struct lod_retile_point old_point = t->points[v];
  repel_walk(t->sheet, &moved, lod_vec3_subtract(lod_vec3_scale(sum, 1 / weight), old_position));
  t->positions[v] = moved.position;
  t->normals[v] = moved.normal;
  t->points[v] = moved.at;
  forget_star(t, v);
  struct star_facts after = look(t, v, enough);
  static const double kGood = 0.75; /* above it shape may be traded */
  bool better = after.upright && (after.shape >= before.shape || after.shape > kGood) && after.error <= before.error;
  if (!better) {
    t->positions[v] = old_position;
    t->normals[v] = old_normal;
    t->points[v] = old_point;
    forget_star(t, v);
  }
  return better;
}

void settle_vertices(struct tiling *tiling, uint32_t level, uint32_t sweeps, double enough) {
  tiling->enough = enough;
  for (uint32_t sweep = 0; sweep < sweeps; sweep++) {
    uint32_t moved = 0;
    for (uint32_t v = 0; v < tiling->vertex_count; v++)
      if (!tiling->dead[v] && !tiling->fixed[v] && tiling->birth[v] <= level && tiling->copies[v] == v && free_to_move(tiling, v))
        moved += settle_one(tiling, v, enough);
    improve_flips(tiling, 2);
    if (moved == 0)
      break;
  }
}
