/* Patterns of triangles in a patch's domain, their bounds, and a cache of them. See pattern.h. */
#include "core/clod/pattern.h"

#include <math.h>
#include <string.h>

#include "core/mesh/mesh.h"

struct pattern_maker {
  struct lod_tessellation_pattern *pattern;
  uint32_t m, factors[3];
};

static void set_vertex(struct pattern_maker *maker, uint32_t index, double a, double b, double c) {
  maker->pattern->domain[index] = (struct lod_barycentric){a, b, c};
}

static void add_triangle(struct pattern_maker *maker, uint32_t a, uint32_t b, uint32_t c) {
  uint32_t *t = maker->pattern->triangles[maker->pattern->triangle_count++];
  t[0] = a, t[1] = b, t[2] = c;
}

/* The i-th of factor + 1 points along side k. */
static uint32_t edge_vertex(const struct pattern_maker *maker, uint32_t k, uint32_t i) {
  if (i == 0)
    return k;
  return i == maker->factors[k] ? (k + 1) % 3 : maker->pattern->edge_vertices[k] + i - 1;
}

/* Inside points (i, j, k >= 1, i + j + k = m) lie in rows of equal k, from k = 1; row k has m - 1 - k points, by rising j. */
static uint32_t inner_vertex(const struct pattern_maker *maker, uint32_t j, uint32_t k) {
  uint32_t rows = k - 1, m = maker->m;
  return maker->pattern->inner_vertices + rows * (m - 2) - rows * (rows - 1) / 2 + (j - 1);
}

/* The s-th of m - 2 points of the ring inside side k, running as the side does. */
static uint32_t ring_vertex(const struct pattern_maker *maker, uint32_t k, uint32_t s) {
  uint32_t m = maker->m, last = m - 2 - s; /* weights: corner k: last, corner k + 1: 1 + s, the third 1 */
  switch (k) {
  case 0:
    return inner_vertex(maker, 1 + s, 1);
  case 1:
    return inner_vertex(maker, last, 1 + s);
  default:
    return inner_vertex(maker, 1, last);
  }
}

static void stitch(struct pattern_maker *maker, uint32_t k) {
  uint32_t outer = maker->factors[k], inner = maker->m - 3, o = 0, i = 0;
  while (o < outer || i < inner) {
    /* Advance where the next point comes first along the side. */
    double next_outer = (o + 0.5) / outer, next_inner = (i + 1.5) / maker->m;
    bool take_outer = i == inner || (o < outer && next_outer <= next_inner);
    uint32_t a = edge_vertex(maker, k, o), b = ring_vertex(maker, k, i);
    if (take_outer)
      add_triangle(maker, a, edge_vertex(maker, k, ++o), b);
    else
      add_triangle(maker, a, ring_vertex(maker, k, ++i), b);
  }
}

static void fill_inside(struct pattern_maker *maker) {
  uint32_t m = maker->m;
  for (uint32_t k = 1; k + 2 <= m; k++)
    for (uint32_t j = 1; j + k + 1 <= m; j++)
      set_vertex(maker, inner_vertex(maker, j, k), (double)(m - j - k) / m, (double)j / m, (double)k / m);
  for (uint32_t k = 1; k + 3 <= m; k++)
    for (uint32_t j = 1; j + k + 2 <= m; j++) {
      uint32_t a = inner_vertex(maker, j, k), b = inner_vertex(maker, j + 1, k), c = inner_vertex(maker, j, k + 1);
      add_triangle(maker, a, b, c);
      if (j + k + 3 <= m)
        add_triangle(maker, b, inner_vertex(maker, j + 1, k + 1), c);
    }
}

/* m of 1 and 2: each edge is whole or halved. */
static void fill_small(struct pattern_maker *maker) {
  uint32_t halved = 0, count = 0;
  for (uint32_t k = 0; k < 3; k++)
    if (maker->factors[k] == 2) {
      halved |= 1u << k;
      count++;
    }
  if (count == 0) {
    add_triangle(maker, 0, 1, 2);
  } else if (count == 3) {
    uint32_t a = edge_vertex(maker, 0, 1), b = edge_vertex(maker, 1, 1), c = edge_vertex(maker, 2, 1);
    add_triangle(maker, 0, a, c);
    add_triangle(maker, 1, b, a);
    add_triangle(maker, 2, c, b);
    add_triangle(maker, a, b, c);
  } else if (count == 1) {
    uint32_t k = halved == 1 ? 0 : halved == 2 ? 1 : 2, middle = edge_vertex(maker, k, 1);
    add_triangle(maker, k, middle, (k + 2) % 3);
    add_triangle(maker, middle, (k + 1) % 3, (k + 2) % 3);
  } else {
    uint32_t whole = (halved & 1) == 0 ? 0 : (halved & 2) == 0 ? 1 : 2; /* from corner `whole`; both other sides are halved */
    uint32_t next = edge_vertex(maker, (whole + 1) % 3, 1), last = edge_vertex(maker, (whole + 2) % 3, 1);
    add_triangle(maker, (whole + 2) % 3, last, next);
    add_triangle(maker, whole, (whole + 1) % 3, next);
    add_triangle(maker, whole, next, last);
  }
}

enum lod_status lod_tessellation_pattern_make(uint32_t m, const uint32_t factors[3], struct lod_arena *arena,
                                              struct lod_tessellation_pattern *pattern) {
  struct pattern_maker maker = {.pattern = pattern, .m = m, .factors = {factors[0], factors[1], factors[2]}};
  *pattern = (struct lod_tessellation_pattern){0};
  uint32_t next = 3;
  for (uint32_t k = 0; k < 3; k++) {
    pattern->edge_vertices[k] = next;
    next += factors[k] - 1;
  }
  pattern->inner_vertices = next;
  uint32_t inside = m >= 3 ? (m - 1) * (m - 2) / 2 : 0;
  pattern->vertex_count = next + inside;
  size_t room = (size_t)m * m + factors[0] + factors[1] + factors[2] + 4;
  pattern->domain = LOD_NEW(arena, pattern->vertex_count, struct lod_barycentric);
  pattern->triangles = lod_arena_alloc(arena, room, sizeof *pattern->triangles);
  if (pattern->domain == NULL || pattern->triangles == NULL)
    return LOD_MEMORY;
  for (uint32_t k = 0; k < 3; k++) {
    double at[3] = {0, 0, 0};
    at[k] = 1;
    set_vertex(&maker, k, at[0], at[1], at[2]);
    for (uint32_t i = 1; i < factors[k]; i++) {
      at[(k + 1) % 3] = (double)i / factors[k];
      at[k] = (double)(factors[k] - i) / factors[k];
      set_vertex(&maker, edge_vertex(&maker, k, i), at[0], at[1], at[2]);
    }
  }
  if (m < 3) {
    fill_small(&maker);
    return LOD_OK;
  }
  fill_inside(&maker);
  for (uint32_t k = 0; k < 3; k++)
    stitch(&maker, k);
  return LOD_OK;
}

/* ---- bounds ---- */

static struct lod_vec3 second(struct lod_vec3 a, struct lod_vec3 b, struct lod_vec3 c) {
  return (struct lod_vec3){6 * (a.x - 2 * b.x + c.x), 6 * (a.y - 2 * b.y + c.y), 6 * (a.z - 2 * b.z + c.z)};
}

struct lod_bend lod_bend_of(const struct lod_bezier *patch) {
  const struct lod_vec3 *p = patch->p;
  struct lod_bend bend = {{{second(p[0], p[3], p[4]), second(p[3], p[4], p[1]), second(p[8], p[9], p[5])},
                           {second(p[4], p[9], p[7]), second(p[1], p[5], p[6]), second(p[5], p[6], p[2])},
                           {second(p[7], p[8], p[0]), second(p[6], p[9], p[3]), second(p[2], p[7], p[8])}}};
  return bend;
}

static inline double larger(double a, double b) {
  return a > b ? a : b;
}

/* Squares of the largest second derivatives along the sides of a small triangle, each over its three corners. For a direction d with
 * coordinates that add up to 0, the second derivative is -(sum over sides s = (a, b) of d_a d_b h_s). */
static void side_bends(const struct lod_bend *bend, const struct lod_tessellation_pattern *pattern, const uint32_t triangle[3],
                       double squares[3]) {
  double at[3][3], h[3][3][3]; /* corner, side, axis */
  for (int c = 0; c < 3; c++) {
    struct lod_barycentric corner = pattern->domain[triangle[c]];
    at[c][0] = corner.u, at[c][1] = corner.v, at[c][2] = corner.w;
    for (int s = 0; s < 3; s++) {
      const struct lod_vec3 *b = bend->h[s];
      h[c][s][0] = corner.u * b[0].x + corner.v * b[1].x + corner.w * b[2].x;
      h[c][s][1] = corner.u * b[0].y + corner.v * b[1].y + corner.w * b[2].y;
      h[c][s][2] = corner.u * b[0].z + corner.v * b[1].z + corner.w * b[2].z;
    }
  }
  for (int e = 0; e < 3; e++) {
    const double *from = at[e], *to = at[e == 2 ? 0 : e + 1];
    double du = to[0] - from[0], dv = to[1] - from[1], dw = to[2] - from[2], uv = du * dv, vw = dv * dw, wu = dw * du;
    squares[e] = 0;
    for (int c = 0; c < 3; c++) {
      double x = uv * h[c][0][0] + vw * h[c][1][0] + wu * h[c][2][0], y = uv * h[c][0][1] + vw * h[c][1][1] + wu * h[c][2][1];
      double z = uv * h[c][0][2] + vw * h[c][1][2] + wu * h[c][2][2];
      squares[e] = larger(squares[e], x * x + y * y + z * z);
    }
  }
}

/* Maximum of 1/2 (x l0 l1 + y l1 l2 + z l2 l0) over barycentric coordinates l: on a side an eighth of its D; inside where the gradient is
 * the same in all three, at l0 : l1 : l2 = y (x + z - y) : z (x + y - z) : x (y + z - x), when these are positive. */
static double triangle_bound(double x, double y, double z) {
  double most = larger(x, larger(y, z)) / 8;
  double l0 = y * (x + z - y), l1 = z * (x + y - z), l2 = x * (y + z - x), sum = l0 + l1 + l2;
  if (!(l0 > 0 && l1 > 0 && l2 > 0))
    return most;
  return larger(most, 0.5 * (x * l0 * l1 + y * l1 * l2 + z * l2 * l0) / (sum * sum));
}

double lod_bend_deviation(const struct lod_bend *bend, const struct lod_tessellation_pattern *pattern, uint32_t begin, uint32_t end) {
  double worst = 0;
  for (uint32_t t = begin; t < end; t++) {
    double squares[3];
    side_bends(bend, pattern, pattern->triangles[t], squares);
    worst = larger(worst, triangle_bound(sqrt(squares[0]), sqrt(squares[1]), sqrt(squares[2])));
  }
  return worst;
}

/* Largest second derivative along each side. */
static void most_bends(const struct lod_bend *bend, double most[3]) {
  for (int s = 0; s < 3; s++) {
    most[s] = 0;
    for (int k = 0; k < 3; k++)
      most[s] = fmax(most[s], lod_vec3_length_squared(bend->h[s][k]));
    most[s] = sqrt(most[s]);
  }
}

/* Bounds of triangles begin up to end for patches whose second derivatives are at most 1 along the sides of the mask, 0 along others. */
static void make_unit_bounds(const struct lod_tessellation_pattern *pattern, uint32_t begin, uint32_t end, double bounds[8]) {
  for (int mask = 0; mask < 8; mask++)
    bounds[mask] = 0;
  for (uint32_t t = begin; t < end; t++) {
    const uint32_t *triangle = pattern->triangles[t];
    double parts[3][3];
    for (int e = 0; e < 3; e++) {
      struct lod_barycentric a = pattern->domain[triangle[e]], b = pattern->domain[triangle[e == 2 ? 0 : e + 1]];
      double du = b.u - a.u, dv = b.v - a.v, dw = b.w - a.w;
      parts[e][0] = fabs(du * dv), parts[e][1] = fabs(dv * dw), parts[e][2] = fabs(dw * du);
    }
    for (int mask = 1; mask < 8; mask++) {
      double sums[3] = {0, 0, 0};
      for (int e = 0; e < 3; e++)
        for (int s = 0; s < 3; s++)
          sums[e] += (mask >> s & 1) != 0 ? parts[e][s] : 0;
      double largest = larger(sums[0], larger(sums[1], sums[2]));
      if (largest > 6 * bounds[mask]) /* a triangle's bound is at most a sixth of the largest */
        bounds[mask] = larger(bounds[mask], triangle_bound(sums[0], sums[1], sums[2]));
    }
  }
}

/* An upper bound of lod_bend_deviation from numbers that the pattern keeps. triangle_bound is a maximum of linear functions with positive
 * factors: rising, homogeneous, and of a sum at most the sum. So the bends are taken in layers: the least along all three sides, what the
 * second has above it along two, what the largest has above that along one. */
static double quick_deviation(const double most[3], const double bounds[8]) {
  int low = most[0] <= most[1] ? 0 : 1, high = 1 - low, middle = 2;
  if (most[2] < most[low])
    middle = low, low = 2;
  else if (most[2] > most[high])
    middle = high, high = 2;
  double sum =
      most[low] * bounds[7] + (most[middle] - most[low]) * bounds[7 & ~(1 << low)] + (most[high] - most[middle]) * bounds[1 << high];
  return sum * (1 + 1e-12);
}

/* ---- the same for four triangles at a time, in float ---- */

typedef int32_t lane_mask __attribute__((vector_size(16)));

static enum lod_status make_ring(struct lod_arena *arena, const struct lod_tessellation_pattern *pattern, uint32_t begin,
                                 struct lod_ring_basis *ring) {
  uint32_t count = pattern->triangle_count - begin;
  ring->blocks = (count + 3) / 4;
  ring->at = lod_arena_alloc(arena, ring->blocks, sizeof *ring->at);
  ring->products = lod_arena_alloc(arena, ring->blocks, sizeof *ring->products);
  if (ring->at == NULL || ring->products == NULL)
    return LOD_MEMORY;
  for (uint32_t i = 0; i < 4 * ring->blocks; i++) {
    const uint32_t *triangle = pattern->triangles[begin + (i < count ? i : 0)];
    for (int c = 0; c < 3; c++) {
      struct lod_barycentric a = pattern->domain[triangle[c]], b = pattern->domain[triangle[c == 2 ? 0 : c + 1]];
      double du = b.u - a.u, dv = b.v - a.v, dw = b.w - a.w;
      lod_lanes *at = ring->at[i / 4][c], *products = ring->products[i / 4][c];
      at[0][i % 4] = (float)a.u, at[1][i % 4] = (float)a.v, at[2][i % 4] = (float)a.w;
      products[0][i % 4] = (float)(du * dv), products[1][i % 4] = (float)(dv * dw), products[2][i % 4] = (float)(dw * du);
    }
  }
  return LOD_OK;
}

/* Squares along the three sides of four triangles. bend: side, corner, axis. */
static void ring_bends(lod_lanes bend[3][3][3], const lod_lanes at[3][3], const lod_lanes products[3][3], lod_lanes squares[3]) {
  for (int e = 0; e < 3; e++)
    squares[e] = (lod_lanes){0, 0, 0, 0};
  for (int c = 0; c < 3; c++) {
    lod_lanes h[3][3];
    for (int s = 0; s < 3; s++)
      for (int axis = 0; axis < 3; axis++)
        h[s][axis] = at[c][0] * bend[s][0][axis] + at[c][1] * bend[s][1][axis] + at[c][2] * bend[s][2][axis];
    for (int e = 0; e < 3; e++) {
      lod_lanes square = {0, 0, 0, 0};
      for (int axis = 0; axis < 3; axis++) {
        lod_lanes sum = products[e][0] * h[0][axis] + products[e][1] * h[1][axis] + products[e][2] * h[2][axis];
        square += sum * sum;
      }
      lane_mask above = square > squares[e];
      squares[e] = (lod_lanes)(((lane_mask)square & above) | ((lane_mask)squares[e] & ~above));
    }
  }
}

/* Stops above `limit`; below a third of it, what is cheaper to tell is told: a sixth of the largest of a side. Rounding is about 20 times
 * 2^-24 of what the terms add up to without their signs, of which `quick` is a bound too. */
static double ring_deviation(const struct lod_bend *bend, const struct lod_ring_basis *ring, double quick, double limit) {
  double scale = 0, worst = 0, cheap = 0; /* in units of scale: floats neither overflow nor vanish */
  lod_lanes lanes[3][3][3];
  for (int s = 0; s < 3; s++)
    for (int k = 0; k < 3; k++)
      scale = larger(scale, larger(fabs(bend->h[s][k].x), larger(fabs(bend->h[s][k].y), fabs(bend->h[s][k].z))));
  if (!(scale > 0 && isfinite(scale)))
    return scale > 0 ? INFINITY : 0;
  limit /= scale;
  for (int s = 0; s < 3; s++)
    for (int k = 0; k < 3; k++) {
      const struct lod_vec3 *h = &bend->h[s][k];
      float x = (float)(h->x / scale), y = (float)(h->y / scale), z = (float)(h->z / scale);
      lanes[s][k][0] = (lod_lanes){x, x, x, x};
      lanes[s][k][1] = (lod_lanes){y, y, y, y};
      lanes[s][k][2] = (lod_lanes){z, z, z, z};
    }
  for (uint32_t block = 0; block < ring->blocks && worst <= limit; block++) {
    lod_lanes squares[3];
    ring_bends(lanes, ring->at[block], ring->products[block], squares);
    for (int i = 0; i < 4; i++) {
      double x = squares[0][i], y = squares[1][i], z = squares[2][i], most = larger(x, larger(y, z));
      if (most <= cheap)
        continue;
      if (most <= 4 * limit * limit)
        cheap = most;
      else
        worst = larger(worst, triangle_bound(sqrt(x), sqrt(y), sqrt(z)));
    }
  }
  return scale * larger(worst, sqrt(cheap) / 6) + 64 * 0x1p-24 * quick;
}

double lod_tessellation_deviation(const struct lod_bezier *patch, const struct lod_tessellation_pattern *pattern) {
  struct lod_bend bend = lod_bend_of(patch);
  return lod_bend_deviation(&bend, pattern, 0, pattern->triangle_count);
}

/* ---- the cache ---- */

/* Patterns by (m, factors), made when first met. */
static uint32_t hash_of(uint32_t m, const uint32_t factors[3]) {
  uint64_t x = m | (uint64_t)factors[0] << 8 | (uint64_t)factors[1] << 16 | (uint64_t)factors[2] << 24;
  x *= 0x9E3779B97F4A7C15u;
  return (uint32_t)(x >> 40);
}

enum lod_status lod_pattern_cache_init(struct lod_pattern_cache *cache, struct lod_arena *arena) {
  enum { FIRST = 256 };
  *cache = (struct lod_pattern_cache){.arena = arena, .capacity = FIRST, .mask = 2 * FIRST - 1};
  cache->entries = LOD_NEW(arena, cache->capacity, struct lod_pattern_entry);
  cache->slots = LOD_NEW(arena, cache->mask + 1, uint32_t);
  if (cache->entries == NULL || cache->slots == NULL)
    return LOD_MEMORY;
  memset(cache->slots, 0xff, (cache->mask + 1) * sizeof *cache->slots);
  return LOD_OK;
}

static enum lod_status cache_grow(struct lod_pattern_cache *cache) {
  uint32_t capacity = 2 * cache->capacity, mask = 2 * capacity - 1;
  struct lod_pattern_entry *entries = LOD_NEW(cache->arena, capacity, struct lod_pattern_entry);
  uint32_t *slots = LOD_NEW(cache->arena, mask + 1, uint32_t);
  if (entries == NULL || slots == NULL)
    return LOD_MEMORY;
  memcpy(entries, cache->entries, cache->count * sizeof *entries);
  memset(slots, 0xff, (mask + 1) * sizeof *slots);
  for (uint32_t e = 0; e < cache->count; e++) {
    uint32_t slot = hash_of(entries[e].m, entries[e].factors) & mask;
    while (slots[slot] != LOD_NONE)
      slot = (slot + 1) & mask;
    slots[slot] = e;
  }
  cache->entries = entries;
  cache->slots = slots;
  cache->capacity = capacity;
  cache->mask = mask;
  return LOD_OK;
}

static enum lod_status make_basis(struct lod_pattern_cache *cache, const struct lod_tessellation_pattern *pattern,
                                  struct lod_grid_basis *grid) {
  uint32_t count = pattern->vertex_count - pattern->inner_vertices, blocks = (count + 3) / 4;
  grid->cubic = lod_arena_alloc(cache->arena, blocks, sizeof *grid->cubic);
  grid->quadratic = lod_arena_alloc(cache->arena, blocks, sizeof *grid->quadratic);
  if (grid->cubic == NULL || grid->quadratic == NULL)
    return LOD_MEMORY;
  grid->blocks = blocks;
  for (uint32_t i = 0; i < 4 * blocks; i++) {
    struct lod_barycentric at = pattern->domain[pattern->inner_vertices + (i < count ? i : 0)];
    double cubic[LOD_BEZIER_POINTS];
    const double quadratic[6] = {at.u * at.u, at.v * at.v, at.w * at.w, 2 * at.u * at.v, 2 * at.v * at.w, 2 * at.w * at.u};
    lod_bezier_basis(at, cubic);
    for (int k = 0; k < 9; k++)
      grid->cubic[i / 4][k][i % 4] = (float)cubic[k + 1];
    for (int k = 0; k < 6; k++)
      grid->quadratic[i / 4][k][i % 4] = (float)quadratic[k];
  }
  return LOD_OK;
}

/* Index of the entry, which moves when more are added. */
enum lod_status lod_pattern_cache_find(struct lod_pattern_cache *cache, uint32_t m, const uint32_t factors[3], uint32_t *found) {
  uint32_t slot = hash_of(m, factors) & cache->mask;
  for (; cache->slots[slot] != LOD_NONE; slot = (slot + 1) & cache->mask) {
    struct lod_pattern_entry *entry = &cache->entries[cache->slots[slot]];
    if (entry->m == m && memcmp(entry->factors, factors, sizeof entry->factors) == 0) {
      *found = cache->slots[slot];
      return LOD_OK;
    }
  }
  if (cache->count == cache->capacity) {
    LOD_TRY(cache_grow(cache));
    return lod_pattern_cache_find(cache, m, factors, found);
  }
  struct lod_pattern_entry *entry = &cache->entries[cache->count];
  entry->m = m;
  memcpy(entry->factors, factors, sizeof entry->factors);
  LOD_TRY(lod_tessellation_pattern_make(m, factors, cache->arena, &entry->pattern));
  uint32_t grid = m < 3 ? 0 : (m - 3) * (m - 3); /* the inner triangles come first and obey the grid's bound */
  make_unit_bounds(&entry->pattern, grid, entry->pattern.triangle_count, entry->unit_bounds);
  LOD_TRY(make_ring(cache->arena, &entry->pattern, grid, &entry->ring));
  if (m >= 3 && cache->grids[m].blocks == 0)
    LOD_TRY(make_basis(cache, &entry->pattern, &cache->grids[m]));
  *found = cache->slots[slot] = cache->count++;
  return LOD_OK;
}

uint32_t lod_pattern_step(double parts) {
  static const uint8_t kSteps[] = {1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48};
  for (uint32_t i = 0; i < sizeof kSteps; i++)
    if (parts <= kSteps[i])
      return kSteps[i];
  return LOD_TESSELLATE_MOST;
}

enum lod_status lod_pattern_choose(struct lod_pattern_cache *cache, const struct lod_bezier *net, const uint32_t factors[3],
                                   double tolerance, uint32_t *grid, uint32_t *number, double *deviation) {
  struct lod_bend bend = lod_bend_of(net);
  double whole = lod_bezier_deviation(net, 1), most[3];
  uint32_t largest = 1;
  most_bends(&bend, most);
  for (uint32_t k = 0; k < 3; k++)
    largest = factors[k] > largest ? factors[k] : largest;
  uint32_t m = lod_pattern_step(lod_bezier_segments(net, tolerance, LOD_TESSELLATE_MOST));
  if (m < 3 && largest > m)
    m = largest == 2 ? 2 : 3;
  for (;; m = lod_pattern_step(m + 1)) {
    LOD_TRY(lod_pattern_cache_find(cache, m, factors, number));
    const struct lod_pattern_entry *entry = &cache->entries[*number];
    uint32_t ring = m < 3 ? 0 : (m - 3) * (m - 3);
    double quick = *deviation = quick_deviation(most, entry->unit_bounds);
    if (quick > tolerance)
      *deviation = fmin(quick, ring_deviation(&bend, &entry->ring, quick, tolerance));
    if (*deviation > tolerance && m == LOD_TESSELLATE_MOST)
      *deviation = lod_bend_deviation(&bend, &entry->pattern, ring, entry->pattern.triangle_count);
    if (ring > 0)
      *deviation = fmax(*deviation, whole / ((double)m * m));
    if (*deviation <= tolerance || m == LOD_TESSELLATE_MOST)
      break;
  }
  *grid = m;
  return LOD_OK;
}
