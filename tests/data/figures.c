#include "tests/data/figures.h"

#include <complex.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static void *must(void *memory) {
  if (memory == NULL)
    abort();
  return memory;
}

/* ---- marching tetrahedra ---- */

struct marcher {
  uint32_t n; /* grid points a side */
  double *values;
  uint32_t *crossings; /* 7 for each grid point: on the edges to the points 1 to 7 steps (bits: x, y, z) ahead, or LOD_NONE */
  struct lod_mesh mesh;
  uint32_t capacity;
};

static uint32_t grid_point(const struct marcher *m, const uint32_t at[3]) {
  return (at[2] * m->n + at[1]) * m->n + at[0];
}

static double place(const struct marcher *m, uint32_t i) {
  return 2.0 * i / (m->n - 1) - 1;
}

/* The vertex between corners a and b (bits) of the cube at `at`. */
static uint32_t crossing(struct marcher *m, const uint32_t at[3], int a, int b) {
  int low = a & b, way = a ^ b; /* of a tetrahedron's corners one is ahead of the other on every axis */
  uint32_t p[3], q[3];
  for (int k = 0; k < 3; k++) {
    p[k] = at[k] + (uint32_t)(low >> k & 1);
    q[k] = p[k] + (uint32_t)(way >> k & 1);
  }
  uint32_t from = grid_point(m, p), *found = &m->crossings[7 * (size_t)from + (size_t)way - 1];
  if (*found != LOD_NONE)
    return *found;
  double x = m->values[from] - 1, y = m->values[grid_point(m, q)] - 1, t = fmin(0.95, fmax(0.05, x / (x - y)));
  for (int k = 0; k < 3; k++)
    m->mesh.positions[m->mesh.vertex_count][k] = (float)((1 - t) * place(m, p[k]) + t * place(m, q[k]));
  return *found = m->mesh.vertex_count++;
}

static void add(struct marcher *m, uint32_t a, uint32_t b, uint32_t c, bool turned) {
  uint32_t *out = m->mesh.triangles[m->mesh.triangle_count++];
  out[0] = a;
  out[1] = turned ? c : b;
  out[2] = turned ? b : c;
}

static void march(struct marcher *m, const uint32_t at[3]) {
  /* Six tetrahedra around the long diagonal, all turned alike. */
  static const int kSix[6][4] = {{0, 1, 3, 7}, {0, 3, 2, 7}, {0, 2, 6, 7}, {0, 6, 4, 7}, {0, 4, 5, 7}, {0, 5, 1, 7}};
  for (int t = 0; t < 6; t++) {
    int in[4], out[4], in_count = 0, out_count = 0, order = 0;
    for (int k = 0; k < 4; k++) {
      uint32_t p[3];
      for (int i = 0; i < 3; i++)
        p[i] = at[i] + (uint32_t)(kSix[t][k] >> i & 1);
      if (m->values[grid_point(m, p)] > 1)
        in[in_count++] = k;
      else
        out[out_count++] = k;
    }
    if (in_count == 0 || out_count == 0)
      continue;
    for (int i = 0; i < in_count; i++) /* is (in, out) an odd permutation? */
      for (int j = 0; j < out_count; j++)
        order += in[i] > out[j];
    uint32_t x[4];
    bool turned = order % 2 != 0;
#define X(i, o) crossing(m, at, kSix[t][in[i]], kSix[t][out[o]])
    if (in_count == 1) {
      for (int o = 0; o < 3; o++)
        x[o] = X(0, o);
      add(m, x[0], x[1], x[2], turned);
    } else if (in_count == 3) {
      for (int i = 0; i < 3; i++)
        x[i] = X(i, 0);
      add(m, x[0], x[1], x[2], turned);
    } else {
      x[0] = X(0, 0);
      x[1] = X(0, 1);
      x[2] = X(1, 1);
      x[3] = X(1, 0);
      add(m, x[0], x[1], x[2], turned);
      add(m, x[0], x[2], x[3], turned);
    }
#undef X
  }
}

struct lod_mesh lod_figure_iso(struct lod_arena *arena, uint32_t cells, double (*field)(const double p[3], const void *context),
                               const void *context) {
  struct marcher m = {.n = cells + 1};
  size_t points = (size_t)m.n * m.n * m.n;
  m.values = must(LOD_NEW(arena, points, double));
  m.crossings = must(LOD_NEW(arena, 7 * points, uint32_t));
  memset(m.crossings, 0xff, 7 * points * sizeof *m.crossings);
  m.mesh.positions = must(lod_arena_alloc(arena, 7 * points, sizeof *m.mesh.positions));
  m.mesh.triangles = must(lod_arena_alloc(arena, 12 * points, sizeof *m.mesh.triangles));
  uint32_t at[3];
  for (at[2] = 0; at[2] < m.n; at[2]++)
    for (at[1] = 0; at[1] < m.n; at[1]++)
      for (at[0] = 0; at[0] < m.n; at[0]++) {
        const double p[3] = {place(&m, at[0]), place(&m, at[1]), place(&m, at[2])};
        m.values[grid_point(&m, at)] = field(p, context);
      }
  for (at[2] = 0; at[2] < cells; at[2]++)
    for (at[1] = 0; at[1] < cells; at[1]++)
      for (at[0] = 0; at[0] < cells; at[0]++)
        march(&m, at);
  return m.mesh;
}

/* ---- the figures ---- */

static double beams(const double p[3], const void *context) {
  static const double kWays[4][3] = {{1, 0.2, 0.1}, {-0.3, 1, 0.2}, {0.1, -0.4, 1}, {0.7, 0.6, -0.6}};
  (void)context;
  double squared = p[0] * p[0] + p[1] * p[1] + p[2] * p[2], sum = 1.1 * exp(-9 * squared);
  for (int i = 0; i < 4; i++) {
    double along = 0, length = 0;
    for (int k = 0; k < 3; k++) {
      along += kWays[i][k] * p[k];
      length += kWays[i][k] * kWays[i][k];
    }
    along /= sqrt(length);
    sum += 1.7 * exp(-45 * (squared - along * along)) * exp(-3.5 * (along - 0.1) * (along - 0.1));
  }
  return sum;
}

struct lod_mesh lod_figure_dose(struct lod_arena *arena, uint32_t cells) {
  return lod_figure_iso(arena, cells, beams, NULL);
}

enum { ATOMS = 22 };

static double densities(const double p[3], const void *context) {
  const double(*atoms)[4] = context;
  double sum = 0;
  for (int i = 0; i < ATOMS; i++) {
    double x = p[0] - atoms[i][0], y = p[1] - atoms[i][1], z = p[2] - atoms[i][2], r = atoms[i][3];
    sum += exp(2.2 - 2.2 * (x * x + y * y + z * z) / (r * r));
  }
  return sum;
}

struct lod_mesh lod_figure_molecule(struct lod_arena *arena, uint32_t cells) {
  double atoms[ATOMS][4];
  for (int i = 0; i < ATOMS; i++) { /* a helix, with a group on every other turn of it */
    double t = 0.62 * i, side = i % 3 == 2 ? 0.62 : 0.34;
    atoms[i][0] = side * cos(t);
    atoms[i][1] = side * sin(t);
    atoms[i][2] = -0.72 + 1.44 * i / (ATOMS - 1);
    atoms[i][3] = i % 3 == 2 ? 0.15 : 0.2;
  }
  return lod_figure_iso(arena, cells, densities, atoms);
}

static const double kPi = 3.14159265358979323846, kE1 = 6.875185818020373; /* Weierstrass's e1 of the periods 1 and i */

/* Weierstrass's zeta and p of the periods 1 and i, by their Fourier series. z is not a period. */
static double complex zeta(double complex z) {
  double turns = floor(cimag(z) + 0.5);
  double complex w = z - turns * I, sum = kPi * w + kPi * ccos(kPi * w) / csin(kPi * w);
  for (int n = 1; n < 12; n++) {
    double q = exp(-2 * kPi * n);
    sum += 4 * kPi * q / (1 - q) * csin(2 * kPi * n * w);
  }
  return sum - turns * kPi * I; /* zeta(z + i) = zeta(z) - pi i */
}

static double complex p_of(double complex z) {
  double complex w = z - floor(cimag(z) + 0.5) * I, s = csin(kPi * w), sum = -kPi + kPi * kPi / (s * s);
  for (int n = 1; n < 12; n++) {
    double q = exp(-2 * kPi * n);
    sum -= 8 * kPi * kPi * n * q / (1 - q) * ccos(2 * kPi * n * w);
  }
  return sum;
}

static void costa_point(double u, double v, float out[3]) {
  double complex z = u + v * I, own = zeta(z), right = zeta(z - 0.5), up = zeta(z - 0.5 * I), p = p_of(z);
  double common = kPi * kPi / (4 * kE1);
  out[0] = (float)(0.5 * creal(-own + kPi * u + common + kPi / (2 * kE1) * (right - up)));
  out[1] = (float)(0.5 * creal(-I * own + kPi * v + common - kPi / (2 * kE1) * (I * right - I * up)));
  out[2] = (float)(0.25 * sqrt(2 * kPi) * log(cabs((p - kE1) / (p + kE1))));
}

/* The end nearest to (u, v), and how far; it is moved out of the disc around it. */
static double from_end(double *u, double *v, double radius) {
  static const double kEnds[3][2] = {{0, 0}, {0.5, 0}, {0, 0.5}};
  double nearest = INFINITY, way[2] = {0, 0};
  for (int i = 0; i < 3; i++) {
    double x = *u - kEnds[i][0], y = *v - kEnds[i][1];
    x -= floor(x + 0.5);
    y -= floor(y + 0.5);
    if (hypot(x, y) < nearest) {
      nearest = hypot(x, y);
      way[0] = x;
      way[1] = y;
    }
  }
  double move = nearest > 0 ? radius / nearest - 1 : 0;
  *u += way[0] * move;
  *v += way[1] * move;
  return nearest;
}

struct lod_mesh lod_figure_costa(struct lod_arena *arena, uint32_t cells, double radius) {
  size_t points = (size_t)cells * cells;
  struct lod_mesh mesh = {0};
  uint32_t *number = must(LOD_NEW(arena, points, uint32_t));
  bool *inside = must(LOD_NEW(arena, points, bool)), *rim = must(LOD_NEW_ZERO(arena, points, bool));
  mesh.positions = must(lod_arena_alloc(arena, points, sizeof *mesh.positions));
  mesh.triangles = must(lod_arena_alloc(arena, 2 * points, sizeof *mesh.triangles));
  for (uint32_t i = 0; i < points; i++) {
    double u = (i % cells + 0.5) / cells, v = (i / cells + 0.5) / cells;
    inside[i] = from_end(&u, &v, radius) < radius;
  }
#define AT(x, y) ((y) % cells * cells + (x) % cells)
  for (uint32_t y = 0; y < cells; y++) /* corners of squares that are in part left out come to lie on the circle */
    for (uint32_t x = 0; x < cells; x++) {
      const uint32_t corners[4] = {AT(x, y), AT(x + 1, y), AT(x + 1, y + 1), AT(x, y + 1)};
      bool any = inside[corners[0]] || inside[corners[1]] || inside[corners[2]] || inside[corners[3]];
      for (int k = 0; k < 4; k++)
        rim[corners[k]] = rim[corners[k]] || any;
    }
  memset(number, 0xff, points * sizeof *number);
  for (uint32_t y = 0; y < cells; y++)
    for (uint32_t x = 0; x < cells; x++) {
      const uint32_t corners[4] = {AT(x, y), AT(x + 1, y), AT(x + 1, y + 1), AT(x, y + 1)};
      if (inside[corners[0]] || inside[corners[1]] || inside[corners[2]] || inside[corners[3]])
        continue;
      for (int k = 0; k < 4; k++) {
        uint32_t c = corners[k];
        double u = (c % cells + 0.5) / cells, v = (c / cells + 0.5) / cells, moved[2] = {u, v};
        if (number[c] != LOD_NONE)
          continue;
        from_end(&moved[0], &moved[1], radius);
        number[c] = mesh.vertex_count++;
        costa_point(rim[c] ? moved[0] : u, rim[c] ? moved[1] : v, mesh.positions[number[c]]);
      }
      const uint32_t two[2][3] = {{corners[0], corners[1], corners[2]}, {corners[0], corners[2], corners[3]}};
      for (int t = 0; t < 2; t++, mesh.triangle_count++)
        for (int k = 0; k < 3; k++)
          mesh.triangles[mesh.triangle_count][k] = number[two[t][k]];
    }
#undef AT
  return mesh;
}
