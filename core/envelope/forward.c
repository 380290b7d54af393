/* Cuts the triangle along the edges of the source triangles below it, walking from one to the next.
 *
 * Based on the convexity lemma of shared algorithms 2.4.2. Ours: where a piece hangs over an edge of the source triangle that certifies the
 * rest of it, it is cut along that edge and what hangs over goes on to the neighbour. The pieces are then about as many as the source
 * triangles below the face, whatever epsilon is; splitting in four needs pieces of the size of epsilon along every edge. */
#include "core/envelope/forward.h"

#include <math.h>
#include <string.h>

#include "core/mesh/adjacency.h"
#include "core/mesh/bvh_tree.h"
#include "core/mesh/triangle_distance.h"

enum { CORNERS = 7, STACK = 96, WALK = 6, SMALL = 1 };

/* A convex polygon of the face; hint: the source triangle likely to be below it. */
struct piece {
  struct lod_vec3 corner[CORNERS];
  uint32_t count, hint, walked;
};

enum lod_status lod_forward_init(struct lod_forward *f, const struct lod_mesh *source, const struct lod_bvh *bvh, struct lod_arena *arena) {
  *f =
      (struct lod_forward){.source = source, .bvh = bvh, .neighbour = lod_arena_alloc(arena, source->triangle_count, sizeof *f->neighbour)};
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct lod_adjacency adjacency;
  if (f->neighbour == NULL || scratch == NULL || lod_adjacency_create_edges(source, scratch, &adjacency) != LOD_OK) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  for (uint32_t h = 0; h < 3 * source->triangle_count; h++) {
    uint32_t twin = adjacency.edge_of[h] == LOD_NONE ? LOD_NONE : adjacency.twin[h];
    f->neighbour[h / 3][h % 3] = twin == LOD_NONE ? LOD_NONE : twin / 3;
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}

static struct lod_vec3 between(struct lod_vec3 a, struct lod_vec3 b, double t) {
  return lod_vec3_add_scaled(a, lod_vec3_subtract(b, a), t);
}

static struct lod_triangle_probe probe_of(const struct lod_forward *f, uint32_t t) {
  const uint32_t *v = f->source->triangles[t];
  return lod_triangle_prepare(lod_vec3_from_float(f->source->positions[v[0]]), lod_vec3_from_float(f->source->positions[v[1]]),
                              lod_vec3_from_float(f->source->positions[v[2]]));
}

/* Squared, of what source triangle t may prove. */
static double squared_at(const struct lod_forward *f, uint32_t t) {
  double epsilon = f->epsilon;
  for (int k = 0; f->limits != NULL && k < 3; k++)
    epsilon = fmin(epsilon, f->limits[f->source->triangles[t][k]]);
  return epsilon * epsilon;
}

static struct lod_vec3 centre_of(const struct piece *piece) {
  struct lod_vec3 sum = piece->corner[0];
  for (uint32_t i = 1; i < piece->count; i++)
    sum = lod_vec3_add(sum, piece->corner[i]);
  return lod_vec3_scale(sum, 1.0 / piece->count);
}

/* Where the corners stand against edge k: positive is the side of the triangle. */
static void edge_sides(const struct lod_triangle_probe *t, int k, const struct piece *piece, double side[CORNERS]) {
  struct lod_vec3 bc = lod_vec3_subtract(t->ac, t->ab);
  struct lod_vec3 inward = k == 0   ? lod_vec3_cross(t->normal, t->ab)
                           : k == 1 ? lod_vec3_cross(t->normal, bc)
                                    : lod_vec3_cross(t->ac, t->normal);
  struct lod_vec3 from = k == 1 ? lod_vec3_add(t->a, t->ab) : t->a;
  for (uint32_t i = 0; i < piece->count; i++)
    side[i] = lod_vec3_dot(inward, lod_vec3_subtract(piece->corner[i], from));
}

/* Both parts of a piece. Cut points are the same bits in both, so nothing falls between them. False when the cut does not cross the border
 * just twice, which rounding can do to corners that are nearly in line with it. */
static bool cut(const struct piece *piece, const double side[CORNERS], struct piece *inside, struct piece *outside) {
  uint32_t crossings = 0;
  for (uint32_t i = 0; i < piece->count; i++)
    crossings += (side[i] > 0) != (side[(i + 1) % piece->count] > 0);
  if (crossings != 2)
    return false;
  inside->count = outside->count = 0;
  for (uint32_t i = 0; i < piece->count; i++) {
    uint32_t j = i + 1 == piece->count ? 0 : i + 1;
    struct piece *to = side[i] > 0 ? inside : outside;
    to->corner[to->count++] = piece->corner[i];
    if ((side[i] > 0) == (side[j] > 0))
      continue;
    struct lod_vec3 at = between(piece->corner[i], piece->corner[j], side[i] / (side[i] - side[j]));
    inside->corner[inside->count++] = at;
    outside->corner[outside->count++] = at;
  }
  return true;
}

/* In two across its longest edge, or a diagonal when a cut would give it too many corners. */
static void halve(const struct piece *piece, struct piece *one, struct piece *other) {
  uint32_t n = piece->count, longest = 0;
  double length = -1;
  for (uint32_t i = 0; i < n; i++) {
    double l = lod_vec3_distance_squared(piece->corner[i], piece->corner[(i + 1) % n]);
    if (l > length) {
      length = l;
      longest = i;
    }
  }
  /* From the middle of the edge to the corner opposite. */
  struct lod_vec3 middle = between(piece->corner[longest], piece->corner[(longest + 1) % n], 0.5);
  uint32_t steps = (n + 1) / 2; /* corners of the first part after the middle */
  one->count = other->count = 0;
  one->corner[one->count++] = middle;
  for (uint32_t s = 1; s <= steps; s++)
    one->corner[one->count++] = piece->corner[(longest + s) % n];
  other->corner[other->count++] = middle;
  for (uint32_t s = steps; s <= n; s++)
    other->corner[other->count++] = piece->corner[(longest + s) % n];
}

enum { PROVEN = 0, REFUTED = -1 }; /* else the parts that a piece was replaced by */

/* Takes the source triangle nearest to the centre next. False: it is beyond epsilon. */
static bool search(const struct lod_forward *f, struct piece *piece, struct lod_vec3 centre) {
  double squared;
  piece->hint = lod_bvh_search(f->bvh, centre, piece->hint, f->epsilon_squared, -1, &squared);
  piece->walked = 0;
  return piece->hint < f->source->triangle_count;
}

static int halve_with_hint(const struct piece *piece, uint32_t hint, struct piece parts[2]) {
  halve(piece, &parts[0], &parts[1]);
  parts[0].hint = parts[1].hint = hint;
  parts[0].walked = parts[1].walked = 0;
  return 2;
}

static double radius_around(const struct piece *piece, struct lod_vec3 centre) {
  double squared = 0;
  for (uint32_t i = 0; i < piece->count; i++)
    squared = fmax(squared, lod_vec3_distance_squared(piece->corner[i], centre));
  return sqrt(squared);
}

/* Where source triangles are small against epsilon, cutting along them would leave crumbs: a ball of the size of epsilon is proven by its
 * centre instead. */
static int divide_by_ball(const struct lod_forward *f, struct piece *piece, struct piece parts[2], struct lod_vec3 *refuter) {
  struct lod_vec3 centre = centre_of(piece);
  double radius = radius_around(piece, centre) * (1 + 1e-12), rest = fmax(0, f->epsilon - radius), squared;
  uint32_t near = lod_bvh_search(f->bvh, centre, piece->hint, f->epsilon_squared, f->limits == NULL ? rest * rest : -1, &squared);
  if (near >= f->source->triangle_count) {
    *refuter = centre;
    return REFUTED;
  }
  if (f->limits != NULL)
    rest = fmax(0, sqrt(squared_at(f, near)) - radius);
  if (!(rest > 0 && squared <= rest * rest))
    return halve_with_hint(piece, near, parts);
  piece->hint = near;
  return PROVEN;
}

/* The edge of the triangle that corner `worst` hangs over farthest, -1 when it is above the triangle. */
static int edge_under(const struct lod_triangle_probe *t, const struct piece *piece, uint32_t worst, double best_side[CORNERS]) {
  double side[CORNERS], farthest = 0;
  int across = -1;
  for (int k = 0; k < 3 && t->normal_squared > 0; k++) {
    double length = lod_vec3_length(k == 0 ? t->ab : k == 1 ? lod_vec3_subtract(t->ac, t->ab) : t->ac);
    edge_sides(t, k, piece, side);
    if (side[worst] < farthest * length) {
      farthest = side[worst] / length;
      across = k;
      memcpy(best_side, side, sizeof side);
    }
  }
  return across;
}

/* The piece lies beside its triangle: on to the next. */
static int walk(const struct lod_forward *f, const struct piece *piece, uint32_t next, uint32_t worst, struct piece parts[2],
                struct lod_vec3 *refuter) {
  parts[0] = *piece;
  if (next != LOD_NONE && ++parts[0].walked <= WALK) {
    parts[0].hint = next;
    return 1;
  }
  *refuter = centre_of(piece);
  if (!search(f, &parts[0], *refuter))
    return REFUTED;
  if (parts[0].hint != piece->hint)
    return 1;
  *refuter = piece->corner[worst];
  uint32_t other = lod_bvh_any_within(f->bvh, *refuter, LOD_NONE, f->epsilon_squared);
  return other >= f->source->triangle_count ? REFUTED : halve_with_hint(piece, piece->hint, parts);
}

/* One piece. */
static int divide(const struct lod_forward *f, struct piece *piece, struct piece parts[2], struct lod_vec3 *refuter) {
  if (piece->hint >= f->source->triangle_count) {
    *refuter = centre_of(piece);
    if (!search(f, piece, *refuter))
      return REFUTED;
  }
  struct lod_triangle_probe t = probe_of(f, piece->hint);
  uint32_t worst = 0;
  double worst_squared = -1;
  for (uint32_t i = 0; i < piece->count; i++) {
    double d = lod_triangle_distance_squared(&t, piece->corner[i]);
    if (d > worst_squared) {
      worst_squared = d;
      worst = i;
    }
  }
  double allowed_squared = squared_at(f, piece->hint);
  if (worst_squared <= allowed_squared)
    return PROVEN;
  double size = fmax(lod_vec3_length_squared(t.ab), lod_vec3_length_squared(t.ac));
  if (size < SMALL * allowed_squared)
    return divide_by_ball(f, piece, parts, refuter);
  double side[CORNERS];
  int across = edge_under(&t, piece, worst, side);
  if (across < 0) { /* the worst corner is above the triangle, too high */
    *refuter = piece->corner[worst];
    uint32_t other = lod_bvh_any_within(f->bvh, *refuter, LOD_NONE, f->epsilon_squared);
    return other >= f->source->triangle_count ? REFUTED : halve_with_hint(piece, LOD_NONE, parts);
  }
  uint32_t next = f->neighbour[piece->hint][across];
  bool some_inside = false;
  for (uint32_t i = 0; i < piece->count; i++)
    some_inside = some_inside || side[i] > 0;
  if (!some_inside)
    return walk(f, piece, next, worst, parts, refuter);
  if (piece->count == CORNERS || !cut(piece, side, &parts[0], &parts[1]))
    return halve_with_hint(piece, piece->hint, parts);
  parts[0].hint = piece->hint;
  parts[1].hint = next;
  parts[0].walked = parts[1].walked = 0;
  return 2;
}

static void add_used(struct lod_forward_used *used, uint32_t triangle) {
  if (used->count > 0 && used->count <= used->capacity && used->triangles[used->count - 1] == triangle)
    return;
  if (used->count < used->capacity)
    used->triangles[used->count] = triangle;
  used->count++;
}

enum lod_forward_answer lod_forward_test(const struct lod_forward *f, const struct lod_vec3 corner[3], uint32_t hint, uint32_t budget,
                                         struct lod_vec3 *refuter, struct lod_forward_used *used) {
  struct piece stack[STACK];
  uint32_t depth = 1;
  memcpy(stack[0].corner, corner, 3 * sizeof *corner);
  stack[0].count = 3;
  stack[0].hint = hint;
  stack[0].walked = 0;
  while (depth > 0) {
    if (budget-- == 0)
      return LOD_FORWARD_OPEN;
    struct piece piece = stack[--depth], parts[2];
    int count = divide(f, &piece, parts, refuter);
    if (count == REFUTED)
      return LOD_FORWARD_REFUTED;
    if (count == PROVEN && used != NULL)
      add_used(used, piece.hint);
    if (depth + (uint32_t)count > STACK)
      return LOD_FORWARD_OPEN;
    for (int i = 0; i < count; i++)
      stack[depth++] = parts[i];
  }
  return LOD_FORWARD_PROVEN;
}

/* Proven by the nearest triangle, or halved. */
static int halve_unless_near(const struct lod_forward *f, struct piece *piece, struct piece parts[2]) {
  if (!search(f, piece, centre_of(piece)))
    return REFUTED;
  struct lod_triangle_probe t = probe_of(f, piece->hint);
  double squared = squared_at(f, piece->hint);
  for (uint32_t i = 0; i < piece->count; i++)
    if (lod_triangle_distance_squared(&t, piece->corner[i]) > squared)
      return halve_with_hint(piece, piece->hint, parts);
  return PROVEN;
}

bool lod_forward_test_by_halves(const struct lod_forward *f, const struct lod_vec3 corner[3], uint32_t budget,
                                struct lod_forward_used *used) {
  struct piece stack[STACK];
  uint32_t depth = 1;
  memcpy(stack[0].corner, corner, 3 * sizeof *corner);
  stack[0].count = 3;
  stack[0].hint = LOD_NONE;
  while (depth > 0) {
    struct piece piece = stack[--depth], parts[2];
    if (budget-- == 0 || depth + 2 > STACK)
      return false;
    int count = halve_unless_near(f, &piece, parts);
    if (count == REFUTED)
      return false;
    if (count == PROVEN)
      add_used(used, piece.hint);
    for (int i = 0; i < count; i++)
      stack[depth++] = parts[i];
  }
  return true;
}
