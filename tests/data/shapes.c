#include "tests/data/shapes.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double kPi = 3.14159265358979323846;

static void *need(void *memory) {
  if (memory == NULL) {
    fprintf(stderr, "tests/data/shapes: no memory\n");
    abort();
  }
  return memory;
}

static struct lod_mesh make(struct lod_arena *arena, uint32_t vertices, uint32_t triangles) {
  struct lod_mesh mesh = {.vertex_count = vertices, .triangle_count = triangles};
  mesh.positions = need(lod_arena_alloc(arena, vertices, sizeof *mesh.positions));
  mesh.triangles = need(lod_arena_alloc(arena, triangles, sizeof *mesh.triangles));
  return mesh;
}

static void set_position(struct lod_mesh *mesh, uint32_t v, double x, double y, double z) {
  mesh->positions[v][0] = (float)x;
  mesh->positions[v][1] = (float)y;
  mesh->positions[v][2] = (float)z;
}

static void set_triangle(struct lod_mesh *mesh, uint32_t t, uint32_t a, uint32_t b, uint32_t c) {
  mesh->triangles[t][0] = a;
  mesh->triangles[t][1] = b;
  mesh->triangles[t][2] = c;
}

struct lod_mesh lod_shape_cube(struct lod_arena *arena, double side) {
  static const uint32_t kTriangles[12][3] = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                                             {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
  struct lod_mesh mesh = make(arena, 8, 12);
  double h = side / 2;
  for (uint32_t v = 0; v < 8; v++)
    set_position(&mesh, v, (v & 1) ? h : -h, (v & 2) ? h : -h, (v & 4) ? h : -h);
  memcpy(mesh.triangles, kTriangles, sizeof kTriangles);
  return mesh;
}

/* Every edge of a closed triangle mesh gets one new vertex; an open-addressing table finds it again from the other side. */
struct midpoints {
  uint64_t *keys;
  uint32_t *vertices;
  uint32_t mask;
};

static uint32_t midpoint(struct midpoints *table, struct lod_vec3 *points, uint32_t *count, uint32_t a, uint32_t b, double radius) {
  uint64_t key = a < b ? (uint64_t)a << 32 | b : (uint64_t)b << 32 | a;
  uint64_t state = key;
  uint32_t slot = (uint32_t)lod_random_next(&state) & table->mask;
  while (table->keys[slot] != 0 && table->keys[slot] != key)
    slot = (slot + 1) & table->mask;
  if (table->keys[slot] == 0) {
    table->keys[slot] = key; /* never 0: the larger vertex is at least 1 */
    table->vertices[slot] = *count;
    points[*count] = lod_vec3_scale(lod_vec3_normalize(lod_vec3_add(points[a], points[b])), radius);
    ++*count;
  }
  return table->vertices[slot];
}

struct lod_mesh lod_shape_sphere(struct lod_arena *arena, double radius, int subdivisions) {
  static const double kPhi = 1.6180339887498949;
  static const uint32_t kTriangles[20][3] = {{0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
                                             {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
                                             {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
  const double corners[12][3] = {{-1, kPhi, 0},  {1, kPhi, 0},  {-1, -kPhi, 0}, {1, -kPhi, 0}, {0, -1, kPhi},  {0, 1, kPhi},
                                 {0, -1, -kPhi}, {0, 1, -kPhi}, {kPhi, 0, -1},  {kPhi, 0, 1},  {-kPhi, 0, -1}, {-kPhi, 0, 1}};
  uint32_t triangle_count = 20u << (2 * subdivisions);
  struct lod_mesh mesh = make(arena, triangle_count / 2 + 2, triangle_count);
  struct lod_arena *scratch = need(lod_arena_create_child(arena));
  struct lod_vec3 *points = need(LOD_NEW(scratch, mesh.vertex_count, struct lod_vec3));
  uint32_t(*next)[3] = need(lod_arena_alloc(scratch, triangle_count, sizeof *next));
  for (int v = 0; v < 12; v++)
    points[v] = lod_vec3_scale(lod_vec3_normalize(lod_vec3_make(corners[v][0], corners[v][1], corners[v][2])), radius);
  memcpy(mesh.triangles, kTriangles, sizeof kTriangles);
  uint32_t vertices = 12;
  for (int step = 0; step < subdivisions; step++) {
    uint32_t old = 20u << (2 * step), slots = 64u << (2 * step); /* 30 * 4^step edges */
    struct midpoints table = {need(LOD_NEW_ZERO(scratch, slots, uint64_t)), need(LOD_NEW(scratch, slots, uint32_t)), slots - 1};
    for (uint32_t t = 0; t < old; t++) {
      const uint32_t *abc = mesh.triangles[t];
      uint32_t ab = midpoint(&table, points, &vertices, abc[0], abc[1], radius);
      uint32_t bc = midpoint(&table, points, &vertices, abc[1], abc[2], radius);
      uint32_t ca = midpoint(&table, points, &vertices, abc[2], abc[0], radius);
      const uint32_t four[4][3] = {{abc[0], ab, ca}, {ab, abc[1], bc}, {ca, bc, abc[2]}, {ab, bc, ca}};
      memcpy(next[(size_t)t * 4], four, sizeof four);
    }
    memcpy(mesh.triangles, next, (size_t)old * 4 * sizeof *next);
  }
  for (uint32_t v = 0; v < mesh.vertex_count; v++)
    lod_vec3_to_float(points[v], mesh.positions[v]);
  lod_arena_destroy(scratch);
  return mesh;
}

struct lod_mesh lod_shape_torus(struct lod_arena *arena, double major, double minor, int around, int tube) {
  uint32_t n = (uint32_t)around, m = (uint32_t)tube;
  struct lod_mesh mesh = make(arena, n * m, 2 * n * m);
  for (uint32_t i = 0; i < n; i++) {
    double a = 2 * kPi * i / n;
    for (uint32_t j = 0; j < m; j++) {
      double b = 2 * kPi * j / m, r = major + minor * cos(b);
      set_position(&mesh, i * m + j, r * cos(a), r * sin(a), minor * sin(b));
      uint32_t i1 = (i + 1) % n, j1 = (j + 1) % m, t = 2 * (i * m + j);
      set_triangle(&mesh, t, i * m + j, i1 * m + j, i1 * m + j1);
      set_triangle(&mesh, t + 1, i * m + j, i1 * m + j1, i * m + j1);
    }
  }
  return mesh;
}

struct lod_mesh lod_shape_grid(struct lod_arena *arena, double side, int cells, double bump) {
  uint32_t n = (uint32_t)cells, row = n + 1;
  struct lod_mesh mesh = make(arena, row * row, 2 * n * n);
  mesh.wedge_count = mesh.vertex_count;
  mesh.corners = need(lod_arena_alloc(arena, mesh.triangle_count, sizeof *mesh.corners));
  mesh.wedge_vertex = need(LOD_NEW(arena, mesh.wedge_count, uint32_t));
  mesh.uvs[0] = need(lod_arena_alloc(arena, mesh.wedge_count, sizeof *mesh.uvs[0]));
  for (uint32_t j = 0; j <= n; j++)
    for (uint32_t i = 0; i <= n; i++) {
      double u = (double)i / n, v = (double)j / n;
      uint32_t vertex = j * row + i;
      set_position(&mesh, vertex, side * (u - 0.5), side * (v - 0.5), bump * sin(2 * kPi * u) * sin(2 * kPi * v));
      mesh.wedge_vertex[vertex] = vertex;
      mesh.uvs[0][vertex][0] = (float)u;
      mesh.uvs[0][vertex][1] = (float)v;
    }
  for (uint32_t j = 0; j < n; j++)
    for (uint32_t i = 0; i < n; i++) {
      uint32_t a = j * row + i, t = 2 * (j * n + i);
      set_triangle(&mesh, t, a, a + 1, a + row + 1);
      set_triangle(&mesh, t + 1, a, a + row + 1, a + row);
    }
  memcpy(mesh.corners, mesh.triangles, mesh.triangle_count * sizeof *mesh.corners);
  return mesh;
}

/* Writes a closed cylinder from `base` towards `axis` (unit) behind what *vertex and *triangle count. */
static void add_tube(struct lod_mesh *mesh, uint32_t *vertex, uint32_t *triangle, struct lod_vec3 base, struct lod_vec3 axis, double length,
                     double radius, uint32_t around, uint32_t along) {
  struct lod_vec3 helper = fabs(axis.x) < 0.9 ? lod_vec3_make(1, 0, 0) : lod_vec3_make(0, 1, 0);
  struct lod_vec3 e1 = lod_vec3_normalize(lod_vec3_cross(axis, lod_vec3_cross(helper, axis)));
  struct lod_vec3 e2 = lod_vec3_cross(axis, e1);
  uint32_t first = *vertex, t = *triangle, bottom = first + around * (along + 1), top = bottom + 1;
  for (uint32_t j = 0; j <= along; j++)
    for (uint32_t i = 0; i < around; i++) {
      double a = 2 * kPi * i / around;
      struct lod_vec3 p = lod_vec3_add_scaled(base, axis, length * j / along);
      p = lod_vec3_add_scaled(lod_vec3_add_scaled(p, e1, radius * cos(a)), e2, radius * sin(a));
      set_position(mesh, first + j * around + i, p.x, p.y, p.z);
    }
  lod_vec3_to_float(base, mesh->positions[bottom]);
  lod_vec3_to_float(lod_vec3_add_scaled(base, axis, length), mesh->positions[top]);
  for (uint32_t i = 0; i < around; i++) {
    uint32_t i1 = (i + 1) % around;
    for (uint32_t j = 0; j < along; j++) {
      uint32_t a = first + j * around + i, b = first + j * around + i1;
      set_triangle(mesh, t++, a, b, b + around);
      set_triangle(mesh, t++, a, b + around, a + around);
    }
    set_triangle(mesh, t++, bottom, first + i1, first + i);
    set_triangle(mesh, t++, top, first + along * around + i, first + along * around + i1);
  }
  *vertex = top + 1;
  *triangle = t;
}

static uint32_t tube_vertices(uint32_t around, uint32_t along) {
  return around * (along + 1) + 2;
}

static uint32_t tube_triangles(uint32_t around, uint32_t along) {
  return 2 * around * along + 2 * around;
}

struct lod_mesh lod_shape_tube(struct lod_arena *arena, double radius, double length, int around, int along) {
  uint32_t n = (uint32_t)around, m = (uint32_t)along, vertex = 0, triangle = 0;
  struct lod_mesh mesh = make(arena, tube_vertices(n, m), tube_triangles(n, m));
  add_tube(&mesh, &vertex, &triangle, lod_vec3_make(0, 0, -length / 2), lod_vec3_make(0, 0, 1), length, radius, n, m);
  return mesh;
}

enum { TREE_FORK = 3, TREE_AROUND = 8, TREE_ALONG = 2, POT_AROUND = 24, POT_ALONG = 4 };

static void add_branch(struct lod_mesh *mesh, uint32_t *vertex, uint32_t *triangle, struct lod_vec3 base, struct lod_vec3 axis,
                       double length, double radius, int generations) {
  if (generations == 0)
    return;
  add_tube(mesh, vertex, triangle, base, axis, length, radius, TREE_AROUND, TREE_ALONG);
  struct lod_vec3 helper = fabs(axis.x) < 0.9 ? lod_vec3_make(1, 0, 0) : lod_vec3_make(0, 1, 0);
  struct lod_vec3 e1 = lod_vec3_normalize(lod_vec3_cross(axis, helper)), e2 = lod_vec3_cross(axis, e1);
  for (int i = 0; i < TREE_FORK; i++) {
    double turn = 2 * kPi * i / TREE_FORK + 0.7 * generations, spread = 0.65;
    struct lod_vec3 side = lod_vec3_add(lod_vec3_scale(e1, cos(turn)), lod_vec3_scale(e2, sin(turn)));
    struct lod_vec3 child = lod_vec3_normalize(lod_vec3_add_scaled(lod_vec3_scale(axis, cos(spread)), side, sin(spread)));
    struct lod_vec3 start = lod_vec3_add_scaled(base, axis, length * (1 - 0.12 * i));
    add_branch(mesh, vertex, triangle, start, child, 0.68 * length, 0.6 * radius, generations - 1);
  }
}

struct lod_mesh lod_shape_tree(struct lod_arena *arena, int generations, bool with_pot) {
  uint32_t branches = 0, power = 1;
  for (int g = 0; g < generations; g++, power *= TREE_FORK)
    branches += power;
  uint32_t vertices = branches * tube_vertices(TREE_AROUND, TREE_ALONG), triangles = branches * tube_triangles(TREE_AROUND, TREE_ALONG);
  if (with_pot) {
    vertices += tube_vertices(POT_AROUND, POT_ALONG);
    triangles += tube_triangles(POT_AROUND, POT_ALONG);
  }
  struct lod_mesh mesh = make(arena, vertices, triangles);
  uint32_t vertex = 0, triangle = 0;
  add_branch(&mesh, &vertex, &triangle, lod_vec3_make(0, 0, 0), lod_vec3_make(0, 0, 1), 1, 0.05, generations);
  if (with_pot)
    add_tube(&mesh, &vertex, &triangle, lod_vec3_make(0, 0, -0.5), lod_vec3_make(0, 0, 1), 0.5, 1.25, POT_AROUND, POT_ALONG);
  return mesh;
}

struct lod_mesh lod_shape_soup(struct lod_arena *arena, uint32_t triangles, double size, uint64_t seed) {
  struct lod_mesh mesh = make(arena, 3 * triangles, triangles);
  for (uint32_t t = 0; t < triangles; t++) {
    double center[3];
    for (int k = 0; k < 3; k++)
      center[k] = size / 2 + (1 - size) * lod_random_unit(&seed);
    for (uint32_t c = 0; c < 3; c++) {
      for (int k = 0; k < 3; k++)
        mesh.positions[3 * t + c][k] = (float)(center[k] + size * (lod_random_unit(&seed) - 0.5));
      mesh.triangles[t][c] = 3 * t + c;
    }
  }
  return mesh;
}

struct lod_mesh lod_shape_join(struct lod_arena *arena, const struct lod_mesh *a, const struct lod_mesh *b, const double offset[3]) {
  struct lod_mesh mesh = make(arena, a->vertex_count + b->vertex_count, a->triangle_count + b->triangle_count);
  mesh.edge_count = a->edge_count + b->edge_count;
  mesh.point_count = a->point_count + b->point_count;
  mesh.edges = need(lod_arena_alloc(arena, mesh.edge_count, sizeof *mesh.edges));
  mesh.points = need(LOD_NEW(arena, mesh.point_count, uint32_t));
  const struct lod_mesh *sources[2] = {a, b};
  uint32_t vertex = 0, triangle = 0, edge = 0, point = 0;
  for (int s = 0; s < 2; s++) {
    const struct lod_mesh *source = sources[s];
    uint32_t first = vertex;
    for (uint32_t v = 0; v < source->vertex_count; v++, vertex++)
      for (int k = 0; k < 3; k++)
        mesh.positions[vertex][k] = s == 0 ? source->positions[v][k] : (float)((double)source->positions[v][k] + offset[k]);
    for (uint32_t t = 0; t < source->triangle_count; t++)
      set_triangle(&mesh, triangle++, first + source->triangles[t][0], first + source->triangles[t][1], first + source->triangles[t][2]);
    for (uint32_t e = 0; e < source->edge_count; e++, edge++)
      for (int k = 0; k < 2; k++)
        mesh.edges[edge][k] = first + source->edges[e][k];
    for (uint32_t p = 0; p < source->point_count; p++)
      mesh.points[point++] = first + source->points[p];
  }
  return mesh;
}

uint64_t lod_random_next(uint64_t *state) {
  uint64_t z = (*state += 0x9e3779b97f4a7c15u);
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}

double lod_random_unit(uint64_t *state) {
  return (double)(lod_random_next(state) >> 11) * 0x1p-53;
}
