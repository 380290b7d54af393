/* Certification of a decoded level.
 *
 * Decoding reorders vertices and triangles, so the family's maps are first carried over to the decoded mesh: a level vertex becomes the
 * decoded vertex nearest to it, a level primitive the decoded primitive on the three. Where every primitive is found, the largest
 * movement of a source vertex bounds both directions: the map is linear on each source triangle, and so is the distance moved. */
#include "server/worker/certify.h"

#include <math.h>
#include <string.h>

#include "core/base/tolerance.h"

static uint64_t mix(uint64_t x) {
  x ^= x >> 30;
  x *= 0xbf58476d1ce4e5b9u;
  x ^= x >> 27;
  x *= 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}

/* Open-addressing multimap from 64-bit keys to chained indices. */
struct index_map {
  uint64_t *keys; /* 0 = free: keys are stored + 1 */
  uint32_t *heads;
  uint32_t *next; /* by index */
  uint64_t mask;
};

static bool index_map_init(struct index_map *map, size_t count, struct lod_arena *arena) {
  size_t capacity = 16;
  while (capacity < 2 * count)
    capacity *= 2;
  map->keys = LOD_NEW_ZERO(arena, capacity, uint64_t);
  map->heads = LOD_NEW(arena, capacity, uint32_t);
  map->next = LOD_NEW(arena, count, uint32_t);
  map->mask = capacity - 1;
  return map->keys != NULL && map->heads != NULL && map->next != NULL;
}

static uint64_t slot_of(const struct index_map *map, uint64_t key) {
  uint64_t slot = key & map->mask;
  while (map->keys[slot] != 0 && map->keys[slot] != key)
    slot = (slot + 1) & map->mask;
  return slot;
}

static void index_map_add(struct index_map *map, uint64_t hash, uint32_t index) {
  uint64_t key = hash | 1;
  uint64_t slot = slot_of(map, key);
  map->next[index] = map->keys[slot] == 0 ? LOD_NONE : map->heads[slot];
  map->keys[slot] = key;
  map->heads[slot] = index;
}

static uint32_t index_map_first(const struct index_map *map, uint64_t hash) {
  uint64_t slot = slot_of(map, hash | 1);
  return map->keys[slot] == 0 ? LOD_NONE : map->heads[slot];
}

static uint64_t hash_cell(int64_t x, int64_t y, int64_t z) {
  return mix((uint64_t)x * 0x9e3779b97f4a7c15u ^ mix((uint64_t)y * 0xc2b2ae3d27d4eb4fu ^ mix((uint64_t)z)));
}

/* matched[level vertex] = nearest decoded vertex within radius, or LOD_NONE. */
static enum lod_status match_vertices(const struct lod_mesh *level, const struct lod_mesh *decoded, double radius, struct lod_arena *arena,
                                      uint32_t *matched) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  struct index_map map;
  if (!index_map_init(&map, decoded->vertex_count, scratch)) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  double cell = 2 * radius;
  for (uint32_t v = 0; v < decoded->vertex_count; v++) {
    const float *p = decoded->positions[v];
    index_map_add(
        &map, hash_cell(llround(floor((double)p[0] / cell)), llround(floor((double)p[1] / cell)), llround(floor((double)p[2] / cell))), v);
  }
  for (uint32_t v = 0; v < level->vertex_count; v++) {
    struct lod_vec3 p = lod_vec3_from_float(level->positions[v]);
    double best = radius * radius;
    matched[v] = LOD_NONE;
    /* The ball of `radius` meets at most the 8 cells around the corner nearest to p. */
    int64_t base[3] = {llround(floor(p.x / cell - 0.5)), llround(floor(p.y / cell - 0.5)), llround(floor(p.z / cell - 0.5))};
    for (int k = 0; k < 8; k++) {
      for (uint32_t u = index_map_first(&map, hash_cell(base[0] + (k & 1), base[1] + (k >> 1 & 1), base[2] + (k >> 2))); u != LOD_NONE;
           u = map.next[u]) {
        double d = lod_vec3_distance_squared(p, lod_vec3_from_float(decoded->positions[u]));
        if (d < best || (d == best && u < matched[v])) {
          best = d;
          matched[v] = u;
        }
      }
    }
  }
  lod_arena_destroy(scratch);
  return LOD_OK;
}

static uint32_t primitive_count(const struct lod_mesh *mesh) {
  return mesh->triangle_count + mesh->edge_count + mesh->point_count;
}

/* The vertices of a primitive in bvh.h's numbering. */
static void primitive_vertices(const struct lod_mesh *mesh, uint32_t primitive, uint32_t v[3]) {
  if (primitive < mesh->triangle_count) {
    memcpy(v, mesh->triangles[primitive], sizeof(uint32_t[3]));
    return;
  }
  primitive -= mesh->triangle_count;
  if (primitive < mesh->edge_count) {
    v[0] = mesh->edges[primitive][0];
    v[1] = v[2] = mesh->edges[primitive][1];
    return;
  }
  v[0] = v[1] = v[2] = mesh->points[primitive - mesh->edge_count];
}

/* The set of a primitive's vertices in ascending order; equal vertices leave a shorter set. Returns its size. */
static int vertex_set(uint32_t v[3]) {
  for (int pass = 0; pass < 2; pass++)
    for (int k = 0; k < 2; k++)
      if (v[k] > v[k + 1]) {
        uint32_t t = v[k];
        v[k] = v[k + 1];
        v[k + 1] = t;
      }
  int size = 1;
  for (int k = 1; k < 3; k++)
    if (v[k] != v[size - 1])
      v[size++] = v[k];
  return size;
}

static uint64_t hash_set(const uint32_t *v, int size) {
  uint64_t h = (uint64_t)size;
  for (int k = 0; k < size; k++)
    h = mix(h ^ ((uint64_t)v[k] + 1) * 0x9e3779b97f4a7c15u);
  return h;
}

/* Finds, for a set of decoded vertices, a decoded primitive whose vertices include them all. */
struct primitive_lookup {
  const struct lod_mesh *mesh;
  struct index_map exact;     /* by whole vertex set */
  uint32_t *incident_offsets; /* vertex -> primitives, CSR */
  uint32_t *incident;
};

static bool lookup_init(struct primitive_lookup *lookup, const struct lod_mesh *mesh, struct lod_arena *arena) {
  uint32_t count = primitive_count(mesh);
  lookup->mesh = mesh;
  if (!index_map_init(&lookup->exact, count, arena))
    return false;
  lookup->incident_offsets = LOD_NEW_ZERO(arena, (size_t)mesh->vertex_count + 2, uint32_t);
  lookup->incident = LOD_NEW(arena, (size_t)count * 3, uint32_t);
  if (lookup->incident_offsets == NULL || lookup->incident == NULL)
    return false;
  uint32_t *ends = lookup->incident_offsets + 1;
  for (uint32_t p = 0; p < count; p++) {
    uint32_t v[3];
    primitive_vertices(mesh, p, v);
    int size = vertex_set(v);
    index_map_add(&lookup->exact, hash_set(v, size), p);
    for (int k = 0; k < size; k++)
      ends[v[k] + 1]++;
  }
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    ends[v + 1] += ends[v];
  for (uint32_t p = 0; p < count; p++) {
    uint32_t v[3];
    primitive_vertices(mesh, p, v);
    int size = vertex_set(v);
    for (int k = 0; k < size; k++)
      lookup->incident[ends[v[k]]++] = p;
  }
  return true;
}

/* set is sorted, of `size` vertices. A primitive on exactly the set when there is one, else any that contains it, else LOD_NONE. */
static uint32_t lookup_find(const struct primitive_lookup *lookup, const uint32_t *set, int size) {
  for (uint32_t p = index_map_first(&lookup->exact, hash_set(set, size)); p != LOD_NONE; p = lookup->exact.next[p]) {
    uint32_t v[3];
    primitive_vertices(lookup->mesh, p, v);
    if (vertex_set(v) == size && memcmp(v, set, (size_t)size * sizeof *set) == 0)
      return p;
  }
  if (size == 3)
    return LOD_NONE;
  for (uint32_t i = lookup->incident_offsets[set[0]]; i < lookup->incident_offsets[set[0] + 1]; i++) {
    uint32_t v[3];
    primitive_vertices(lookup->mesh, lookup->incident[i], v);
    if (size == 1 || v[0] == set[1] || v[1] == set[1] || v[2] == set[1])
      return lookup->incident[i];
  }
  return LOD_NONE;
}

/* What the family's maps give once they are carried over to the decoded mesh. */
struct carried {
  uint32_t *hint_ab, *hint_ba;
  double upper_ab, upper_ba;
};

/* The decoded vertices that stand for a source primitive's; false when some vertex has none. */
static bool map_image(const struct lod_certify_request *request, const uint32_t *matched, const uint32_t v[3], uint32_t mapped[3]) {
  if (request->image == NULL)
    return false;
  for (int k = 0; k < 3; k++) {
    uint32_t to = request->image[v[k]];
    mapped[k] = to == LOD_NONE ? LOD_NONE : matched[to];
    if (mapped[k] == LOD_NONE)
      return false;
  }
  return true;
}

/* The decoded primitive that the family says lies near source primitive s, or LOD_NONE. */
static uint32_t find_nearby(const struct lod_certify_request *request, const uint32_t *matched, const struct primitive_lookup *lookup,
                            uint32_t s) {
  if (request->nearby == NULL || s >= request->source->triangle_count || request->nearby[s] >= primitive_count(request->level))
    return LOD_NONE;
  uint32_t v[3];
  primitive_vertices(request->level, request->nearby[s], v);
  for (int k = 0; k < 3; k++) {
    v[k] = matched[v[k]];
    if (v[k] == LOD_NONE)
      return LOD_NONE;
  }
  int size = vertex_set(v);
  return lookup_find(lookup, v, size);
}

static enum lod_status carry_maps(const struct lod_certify_request *request, struct lod_arena *arena, struct carried *carried) {
  const struct lod_mesh *source = request->source, *level = request->level, *decoded = request->decoded;
  uint32_t source_count = primitive_count(source), decoded_count = primitive_count(decoded);
  uint32_t *matched = LOD_NEW(arena, level->vertex_count, uint32_t);
  carried->hint_ab = LOD_NEW(arena, source_count, uint32_t);
  carried->hint_ba = LOD_NEW(arena, decoded_count, uint32_t);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct primitive_lookup lookup;
  bool *covered = scratch == NULL ? NULL : LOD_NEW_ZERO(scratch, decoded_count, bool);
  if (matched == NULL || carried->hint_ab == NULL || carried->hint_ba == NULL || covered == NULL) {
    lod_arena_destroy(scratch);
    return LOD_MEMORY;
  }
  double magnitude = fmax(lod_mesh_magnitude(level), lod_mesh_magnitude(decoded));
  double radius = request->position_error * 1.0001 + 0x1p-20 * magnitude; /* the decoder's own float rounding */
  enum lod_status status = match_vertices(level, decoded, radius, scratch, matched);
  if (status == LOD_OK && !lookup_init(&lookup, decoded, scratch))
    status = LOD_MEMORY;
  if (status != LOD_OK) {
    lod_arena_destroy(scratch);
    return status;
  }
  memset(carried->hint_ab, 0xff, (size_t)source_count * sizeof *carried->hint_ab);
  memset(carried->hint_ba, 0xff, (size_t)decoded_count * sizeof *carried->hint_ba);
  bool all_images_present = request->image != NULL;
  uint32_t covered_count = 0; /* decoded primitives that are exactly some source primitive's image */
  double moved = 0;
  for (uint32_t s = 0; s < source_count; s++) {
    uint32_t v[3], set[3];
    primitive_vertices(source, s, v);
    bool known = map_image(request, matched, v, set);
    for (int k = 0; known && k < 3; k++)
      moved = fmax(
          moved, lod_vec3_distance_squared(lod_vec3_from_float(source->positions[v[k]]), lod_vec3_from_float(decoded->positions[set[k]])));
    int size = known ? vertex_set(set) : 0;
    uint32_t found = known ? lookup_find(&lookup, set, size) : LOD_NONE;
    if (found == LOD_NONE) {
      all_images_present = false;
      found = find_nearby(request, matched, &lookup, s);
      size = 0;
    }
    carried->hint_ab[s] = found;
    if (found == LOD_NONE)
      continue;
    primitive_vertices(decoded, found, v);
    bool exact = size != 0 && vertex_set(v) == size;
    if (exact && !covered[found]) {
      covered[found] = true;
      covered_count++;
      carried->hint_ba[found] = s;
    } else if (carried->hint_ba[found] == LOD_NONE) {
      carried->hint_ba[found] = s;
    }
  }
  moved = sqrt(moved) + lod_tolerance_rounding(fmax(magnitude, lod_mesh_magnitude(source)));
  carried->upper_ab = all_images_present ? moved : INFINITY;
  carried->upper_ba = all_images_present && covered_count == decoded_count ? moved : INFINITY;
  lod_arena_destroy(scratch);
  return LOD_OK;
}

enum lod_status lod_certify_unit(const struct lod_certify_request *request, struct lod_arena *arena, struct lod_distance *distance) {
  struct lod_arena *scratch = lod_arena_create_child(arena);
  if (scratch == NULL)
    return LOD_MEMORY;
  struct carried carried;
  enum lod_status status = carry_maps(request, scratch, &carried);
  if (status == LOD_OK) {
    struct lod_distance_settings settings = lod_distance_defaults();
    settings.absolute = request->absolute;
    settings.threads = request->threads;
    settings.known_upper_ab = carried.upper_ab;
    settings.known_upper_ba = carried.upper_ba;
    settings.bvh_a = request->source_bvh;
    settings.larger_side_only = true;
    settings.hint_ab = carried.hint_ab;
    settings.hint_ba = carried.hint_ba;
    settings.progress = request->progress;
    status = lod_distance_measure(request->source, request->decoded, &settings, scratch, distance);
  }
  lod_arena_destroy(scratch);
  return status;
}
