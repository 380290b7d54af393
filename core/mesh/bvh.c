/* Builds the packed tree of bvh_tree.h: sort by Hilbert key, then boxes bottom-up.
 *
 * Based on: Kamel, Faloutsos. Hilbert R-tree: an improved R-tree using fractals. 1994 (packing along the curve); keys after Hamilton,
 * Rau-Chaplin. Compact Hilbert indices. 2008. A packed tree needs no top-down splitting, so building is a sort and one sweep. */
#include "core/mesh/bvh.h"

#include <assert.h>
#include <string.h>

#include "core/base/parallel.h"
#include "core/mesh/bvh_tree.h"

enum {
  KEY_LEVELS = 16, /* bits an axis: 48-bit keys */
  DIGIT_BITS = 12, /* four passes */
  DIGITS = 1 << DIGIT_BITS,
  SORT_GRAIN = 1 << 16,
  NODE_GRAIN = 1 << 11,
  KEY_TABLE = 24 * 64, /* orientations x two levels of octants */
};

struct sort_entry {
  uint64_t key;
  uint32_t primitive;
};

/* Two levels of octants at once: index orientation * 64 + octants, value next orientation * 64 | two curve digits. */
struct key_table {
  uint16_t steps[KEY_TABLE];
};

struct build {
  const struct lod_mesh *mesh;
  struct lod_bvh *bvh;
  const struct key_table *table;
  double origin[3], scale;
  struct sort_entry *from, *to;
  uint32_t *histograms; /* chunks x DIGITS */
  int shift;
  uint32_t level;
  struct lod_bounds *chunk_bounds;
};

static uint32_t rotate_left3(uint32_t x, uint32_t by) {
  by %= 3;
  return (x << by | x >> (3 - by)) & 7;
}

static uint32_t trailing_ones(uint32_t x) {
  uint32_t count = 0;
  while (x >> count & 1)
    count++;
  return count;
}

/* One step of the curve: in orientation (entry, direction), octant -> digit and next orientation (Hamilton's T, gc, e and d). */
static uint32_t key_step(uint32_t orientation, uint32_t octant, uint32_t *next) {
  uint32_t entry = orientation / 3, direction = orientation % 3;
  uint32_t turned = rotate_left3(octant ^ entry, 3 - (direction + 1) % 3);
  uint32_t digit = turned ^ turned >> 1 ^ turned >> 2;
  uint32_t before = digit == 0 ? 0 : (digit - 1) & ~1u;
  uint32_t child_entry = before ^ before >> 1;
  uint32_t child_direction = digit == 0 ? 0 : trailing_ones(digit & 1 ? digit : digit - 1) % 3;
  *next = (entry ^ rotate_left3(child_entry, direction + 1)) * 3 + (direction + child_direction + 1) % 3;
  return digit;
}

static void fill_key_table(struct key_table *table) {
  for (uint32_t orientation = 0; orientation < 24; orientation++) {
    for (uint32_t octants = 0; octants < 64; octants++) {
      uint32_t middle, last;
      uint32_t high = key_step(orientation, octants >> 3, &middle);
      uint32_t low = key_step(middle, octants & 7, &last);
      table->steps[orientation * 64 + octants] = (uint16_t)(last << 6 | high << 3 | low);
    }
  }
}

/* Bits of a 16-bit number, three places apart. */
static uint64_t spread(uint32_t x) {
  uint64_t v = x;
  v = (v | v << 16) & 0x0000ff0000ffu;
  v = (v | v << 8) & 0x00f00f00f00fu;
  v = (v | v << 4) & 0x0c30c30c30c3u;
  return (v | v << 2) & 0x249249249249u;
}

static uint64_t hilbert_key(const struct key_table *table, const uint32_t cell[3]) {
  uint64_t octants = spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2;
  uint64_t key = 0;
  uint32_t orientation = 0;
  for (int shift = 3 * KEY_LEVELS - 6; shift >= 0; shift -= 6) {
    uint32_t step = table->steps[orientation << 6 | (octants >> shift & 63)];
    key = key << 6 | (step & 63);
    orientation = step >> 6;
  }
  return key;
}

static void gather(const struct lod_mesh *mesh, uint32_t primitive, float corners[3][3]) {
  uint32_t triple[3];
  lod_mesh_primitive(mesh, primitive, triple);
  for (int i = 0; i < 3; i++)
    memcpy(corners[i], mesh->positions[triple[i]], sizeof corners[i]);
}

/* Centre of a primitive's box. */
static void centre(const struct lod_mesh *mesh, uint32_t primitive, double out[3]) {
  float c[3][3];
  gather(mesh, primitive, c);
  for (int k = 0; k < 3; k++) {
    float low = fminf(fminf(c[0][k], c[1][k]), c[2][k]), high = fmaxf(fmaxf(c[0][k], c[1][k]), c[2][k]);
    out[k] = 0.5 * ((double)low + (double)high);
  }
}

static void bound_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct build *build = context;
  struct lod_bounds bounds = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
  for (size_t i = begin; i < end; i++) {
    double c[3];
    centre(build->mesh, (uint32_t)i, c);
    for (int k = 0; k < 3; k++) {
      bounds.min[k] = c[k] < bounds.min[k] ? c[k] : bounds.min[k];
      bounds.max[k] = c[k] > bounds.max[k] ? c[k] : bounds.max[k];
    }
  }
  build->chunk_bounds[chunk] = bounds;
}

static void key_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct build *build = context;
  (void)chunk;
  for (size_t i = begin; i < end; i++) {
    double c[3];
    uint32_t cell[3];
    centre(build->mesh, (uint32_t)i, c);
    for (int k = 0; k < 3; k++)
      cell[k] = (uint32_t)((c[k] - build->origin[k]) * build->scale);
    build->from[i] = (struct sort_entry){hilbert_key(build->table, cell), (uint32_t)i};
  }
}

static void count_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct build *build = context;
  uint32_t *histogram = build->histograms + chunk * DIGITS;
  memset(histogram, 0, DIGITS * sizeof *histogram);
  for (size_t i = begin; i < end; i++)
    histogram[build->from[i].key >> build->shift & (DIGITS - 1)]++;
}

static void scatter_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct build *build = context;
  uint32_t *place = build->histograms + chunk * DIGITS;
  for (size_t i = begin; i < end; i++)
    build->to[place[build->from[i].key >> build->shift & (DIGITS - 1)]++] = build->from[i];
}

/* Stable radix sort by key, equal keys by primitive: the same order for any number of threads. */
static void sort(struct build *build, uint32_t threads) {
  size_t count = build->bvh->count, chunks = lod_parallel_chunks(count, SORT_GRAIN);
  for (build->shift = 0; build->shift < 3 * KEY_LEVELS; build->shift += DIGIT_BITS) {
    lod_parallel_for(threads, count, SORT_GRAIN, count_chunk, build);
    uint32_t sum = 0;
    for (size_t digit = 0; digit < DIGITS; digit++) {
      for (size_t chunk = 0; chunk < chunks; chunk++) {
        uint32_t *slot = &build->histograms[chunk * DIGITS + digit];
        uint32_t here = *slot;
        *slot = sum;
        sum += here;
      }
    }
    lod_parallel_for(threads, count, SORT_GRAIN, scatter_chunk, build);
    struct sort_entry *swap = build->from;
    build->from = build->to;
    build->to = swap;
  }
}

static void set_lane(struct lod_bvh_node *node, int lane, const float min[3], const float max[3]) {
  for (int k = 0; k < 3; k++) {
    node->min[k][lane] = min[k];
    node->max[k][lane] = max[k];
  }
}

static void leaf_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct build *build = context;
  struct lod_bvh *bvh = build->bvh;
  (void)chunk;
  for (size_t i = begin; i < end; i++) {
    for (int lane = 0; lane < LOD_BVH_WIDTH; lane++) {
      float min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY};
      size_t slot = (i * LOD_BVH_WIDTH + (size_t)lane) * LOD_BVH_LEAF;
      for (size_t last = slot + LOD_BVH_LEAF; slot < last && slot < bvh->count; slot++) {
        bvh->order[slot] = build->from[slot].primitive;
        gather(build->mesh, bvh->order[slot], bvh->corners[slot]);
        for (int corner = 0; corner < 3; corner++) {
          for (int k = 0; k < 3; k++) {
            float x = bvh->corners[slot][corner][k];
            min[k] = x < min[k] ? x : min[k];
            max[k] = x > max[k] ? x : max[k];
          }
        }
      }
      set_lane(&bvh->levels[0][i], lane, min, max);
    }
  }
}

static void node_chunk(void *context, size_t begin, size_t end, size_t chunk) {
  struct build *build = context;
  struct lod_bvh *bvh = build->bvh;
  (void)chunk;
  for (size_t i = begin; i < end; i++) {
    for (int lane = 0; lane < LOD_BVH_WIDTH; lane++) {
      float min[3] = {INFINITY, INFINITY, INFINITY}, max[3] = {-INFINITY, -INFINITY, -INFINITY};
      size_t child = i * LOD_BVH_WIDTH + (size_t)lane;
      if (child < bvh->node_counts[build->level - 1]) {
        const struct lod_bvh_node *node = &bvh->levels[build->level - 1][child];
        for (int k = 0; k < 3; k++) {
          for (int j = 0; j < LOD_BVH_WIDTH; j++) {
            min[k] = node->min[k][j] < min[k] ? node->min[k][j] : min[k];
            max[k] = node->max[k][j] > max[k] ? node->max[k][j] : max[k];
          }
        }
      }
      set_lane(&bvh->levels[build->level][i], lane, min, max);
    }
  }
}

/* Cubical cells over the box of the centres, KEY_LEVELS bits along its longest side. */
static void choose_cells(struct build *build, uint32_t threads) {
  size_t count = build->bvh->count, chunks = lod_parallel_chunks(count, SORT_GRAIN);
  lod_parallel_for(threads, count, SORT_GRAIN, bound_chunk, build);
  struct lod_bounds all = build->chunk_bounds[0];
  double extent = 0;
  for (int k = 0; k < 3; k++) {
    for (size_t i = 1; i < chunks; i++) {
      all.min[k] = fmin(all.min[k], build->chunk_bounds[i].min[k]);
      all.max[k] = fmax(all.max[k], build->chunk_bounds[i].max[k]);
    }
    build->origin[k] = all.min[k];
    extent = fmax(extent, all.max[k] - all.min[k]);
  }
  build->scale = extent > 0 ? ((1 << KEY_LEVELS) - 0.5) / extent : 0;
}

static bool allocate_tree(struct lod_bvh *bvh, struct lod_arena *arena) {
  bvh->order = LOD_NEW(arena, bvh->count, uint32_t);
  bvh->corners = lod_arena_alloc(arena, bvh->count, sizeof *bvh->corners);
  uint32_t children = (uint32_t)lod_parallel_chunks(bvh->count, LOD_BVH_LEAF);
  do {
    assert(bvh->level_count < LOD_BVH_LEVELS);
    uint32_t nodes = (uint32_t)lod_parallel_chunks(children, LOD_BVH_WIDTH);
    bvh->node_counts[bvh->level_count] = nodes;
    bvh->levels[bvh->level_count] = LOD_NEW(arena, nodes, struct lod_bvh_node);
    if (bvh->levels[bvh->level_count++] == NULL)
      return false;
    children = nodes;
  } while (children > 1);
  return bvh->order != NULL && bvh->corners != NULL;
}

static enum lod_status build_tree(struct build *build, uint32_t threads, struct lod_arena *scratch) {
  struct lod_bvh *bvh = build->bvh;
  size_t chunks = lod_parallel_chunks(bvh->count, SORT_GRAIN);
  struct key_table *table = LOD_NEW(scratch, 1, struct key_table);
  build->from = LOD_NEW(scratch, bvh->count, struct sort_entry);
  build->to = LOD_NEW(scratch, bvh->count, struct sort_entry);
  build->histograms = LOD_NEW(scratch, chunks * DIGITS, uint32_t);
  build->chunk_bounds = LOD_NEW(scratch, chunks, struct lod_bounds);
  if (table == NULL || build->from == NULL || build->to == NULL || build->histograms == NULL || build->chunk_bounds == NULL)
    return LOD_MEMORY;
  fill_key_table(table);
  build->table = table;
  choose_cells(build, threads);
  lod_parallel_for(threads, bvh->count, SORT_GRAIN, key_chunk, build);
  sort(build, threads);
  lod_parallel_for(threads, bvh->node_counts[0], NODE_GRAIN, leaf_chunk, build);
  for (build->level = 1; build->level < bvh->level_count; build->level++)
    lod_parallel_for(threads, bvh->node_counts[build->level], NODE_GRAIN, node_chunk, build);
  return LOD_OK;
}

enum lod_status lod_bvh_create(const struct lod_mesh *mesh, uint32_t threads, struct lod_arena *arena, struct lod_bvh **out) {
  *out = NULL;
  uint64_t count = (uint64_t)mesh->triangle_count + mesh->edge_count + mesh->point_count;
  if (count >= LOD_NONE)
    return LOD_MEMORY;
  struct lod_bvh *bvh = LOD_NEW_ZERO(arena, 1, struct lod_bvh);
  if (bvh == NULL)
    return LOD_MEMORY;
  bvh->mesh = mesh;
  bvh->count = (uint32_t)count;
  if (count > 0) {
    if (!allocate_tree(bvh, arena))
      return LOD_MEMORY;
    struct lod_arena *scratch = lod_arena_create_child(arena);
    if (scratch == NULL)
      return LOD_MEMORY;
    struct build build = {.mesh = mesh, .bvh = bvh};
    enum lod_status status = build_tree(&build, threads, scratch);
    lod_arena_destroy(scratch);
    LOD_TRY(status);
  }
  *out = bvh;
  return LOD_OK;
}
