/* Writes the sample models of `make run` as binary PLY: sample knot|tree OUT.ply
 *
 * knot: a trefoil knot of a ribbed, beaded tube with vertex colours, 256 000 triangles, closed.
 * tree: a leafless tree of thin closed tubes, which clustering turns into thick edges. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/data/shapes.h"

enum { KNOT_AROUND = 2000, KNOT_TUBE = 64 };
static const double kTau = 6.283185307179586;

static void put(FILE *out, const void *bytes, size_t size) {
  if (fwrite(bytes, 1, size, out) != size) {
    perror("sample");
    exit(1);
  }
}

static void put_header(FILE *out, uint32_t vertices, uint32_t triangles, int colors) {
  fprintf(out,
          "ply\nformat binary_little_endian 1.0\ncomment made by Lodestream's tests/sample\nelement vertex %u\nproperty float x\nproperty "
          "float y\n"
          "property float z\n%selement face %u\nproperty list uchar int vertex_indices\nend_header\n",
          vertices, colors ? "property uchar red\nproperty uchar green\nproperty uchar blue\n" : "", triangles);
}

static void put_triangle(FILE *out, uint32_t a, uint32_t b, uint32_t c) {
  uint8_t three = 3;
  uint32_t v[3] = {a, b, c};
  put(out, &three, 1);
  put(out, v, sizeof v);
}

static struct lod_vec3 knot_centre(double u) {
  return lod_vec3_make(sin(u) + 2 * sin(2 * u), cos(u) - 2 * cos(2 * u), -1.1 * sin(3 * u));
}

/* A frame that closes up: the tube turns with the curve's own normal field towards the axis. */
static void knot_vertex(double u, double v, struct lod_vec3 *position, uint8_t rgb[3]) {
  const double step = 1e-4;
  struct lod_vec3 centre = knot_centre(u);
  struct lod_vec3 tangent = lod_vec3_normalize(lod_vec3_subtract(knot_centre(u + step), knot_centre(u - step)));
  struct lod_vec3 side = lod_vec3_normalize(lod_vec3_cross(tangent, lod_vec3_make(centre.y, -centre.x, 1.5)));
  struct lod_vec3 up = lod_vec3_cross(side, tangent);
  double rib = 0.5 + 0.5 * cos(6 * v + 18 * u);
  double bead = pow(0.5 + 0.5 * cos(48 * u), 6) * pow(0.5 + 0.5 * cos(3 * v - 9 * u), 4);
  double grain = 0.004 * sin(160 * u + 3 * v) * sin(20 * v);
  double radius = 0.62 * (1 + 0.16 * rib * rib) + 0.10 * bead + grain;
  *position = lod_vec3_add(centre, lod_vec3_add(lod_vec3_scale(side, radius * cos(v)), lod_vec3_scale(up, radius * sin(v))));
  double warm = 0.5 + 0.5 * sin(u + 0.6);
  rgb[0] = (uint8_t)(70 + 120 * warm + 60 * bead);
  rgb[1] = (uint8_t)(92 + 60 * rib + 50 * bead);
  rgb[2] = (uint8_t)(150 - 70 * warm + 50 * rib);
}

static void write_knot(FILE *out) {
  put_header(out, KNOT_AROUND * KNOT_TUBE, 2 * KNOT_AROUND * KNOT_TUBE, 1);
  for (int i = 0; i < KNOT_AROUND; i++)
    for (int j = 0; j < KNOT_TUBE; j++) {
      struct lod_vec3 p;
      uint8_t rgb[3];
      float xyz[3];
      knot_vertex(kTau * i / KNOT_AROUND, kTau * j / KNOT_TUBE, &p, rgb);
      lod_vec3_to_float(p, xyz);
      put(out, xyz, sizeof xyz);
      put(out, rgb, sizeof rgb);
    }
  for (uint32_t i = 0; i < KNOT_AROUND; i++)
    for (uint32_t j = 0; j < KNOT_TUBE; j++) {
      uint32_t i1 = (i + 1) % KNOT_AROUND, j1 = (j + 1) % KNOT_TUBE;
      uint32_t a = i * KNOT_TUBE + j, b = i1 * KNOT_TUBE + j, c = i1 * KNOT_TUBE + j1, d = i * KNOT_TUBE + j1;
      put_triangle(out, a, c, b);
      put_triangle(out, a, d, c);
    }
}

static void write_tree(FILE *out) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_mesh tree = lod_shape_tree(arena, 7, false);
  put_header(out, tree.vertex_count, tree.triangle_count, 0);
  for (uint32_t v = 0; v < tree.vertex_count; v++) { /* z is up in the shapes, y in the viewer */
    float xyz[3] = {tree.positions[v][0], tree.positions[v][2], -tree.positions[v][1]};
    put(out, xyz, sizeof xyz);
  }
  for (uint32_t t = 0; t < tree.triangle_count; t++)
    put_triangle(out, tree.triangles[t][0], tree.triangles[t][1], tree.triangles[t][2]);
  lod_arena_destroy(arena);
}

int main(int argc, char **argv) {
  if (argc != 3 || (strcmp(argv[1], "knot") != 0 && strcmp(argv[1], "tree") != 0)) {
    fprintf(stderr, "usage: sample knot|tree OUT.ply\n");
    return 2;
  }
  FILE *out = fopen(argv[2], "wb");
  if (out == NULL) {
    perror(argv[2]);
    return 1;
  }
  if (strcmp(argv[1], "knot") == 0)
    write_knot(out);
  else
    write_tree(out);
  if (fclose(out) != 0) {
    perror(argv[2]);
    return 1;
  }
  return 0;
}
