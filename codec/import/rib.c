/* RenderMan RIB, as far as patches go: Patch, PatchMesh and NuPatch under their transforms; everything else is passed over.
 *
 * Based on: Pixar. The RenderMan Interface, version 3.2. 2000 (requests, bases, steps). Bases other than Bezier become Bezier by their
 * matrices, NuPatch by knot insertion (Boehm. Inserting New Knots into B-Spline Curves. 1980). Of several worlds (a scene that is drawn in
 * several passes) the first that has patches is taken. Text only. */
#include <math.h>
#include <string.h>

#include "codec/import/number.h"
#include "codec/import/spline.h"

enum { STACK = 64, MAX_ORDER = LOD_SPLINE_DEGREE + 1, WORD = 64 };

struct basis {
  double m[4][4]; /* rows: powers 3, 2, 1, 0; columns: control points */
  uint32_t step;
};

struct state {
  double matrix[16];
  struct basis basis[2];
};

struct rib {
  struct lod_reader *reader;
  struct lod_splines splines;
  const char *at, *end;
  uint64_t line, request_line;
  struct state stack[STACK];
  uint32_t depth;
  double *numbers; /* the last array */
  uint32_t number_count, number_room;
  bool over; /* a world with patches has ended */
};

static const struct {
  const char *name;
  struct basis basis;
} kBases[] = {
    {"bezier", {{{-1, 3, -3, 1}, {3, -6, 3, 0}, {-3, 3, 0, 0}, {1, 0, 0, 0}}, 3}},
    {"b-spline",
     {{{-1 / 6.0, 3 / 6.0, -3 / 6.0, 1 / 6.0}, {3 / 6.0, -1, 3 / 6.0, 0}, {-3 / 6.0, 0, 3 / 6.0, 0}, {1 / 6.0, 4 / 6.0, 1 / 6.0, 0}}, 1}},
    {"catmull-rom", {{{-0.5, 1.5, -1.5, 0.5}, {1, -2.5, 2, -0.5}, {-0.5, 0, 0.5, 0}, {0, 1, 0, 0}}, 1}},
    {"hermite", {{{2, 1, -2, 1}, {-3, -2, 3, -1}, {0, 1, 0, 0}, {1, 0, 0, 0}}, 2}},
    {"power", {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}}, 4}},
};

static enum lod_status bad(struct rib *rib, const char *what) {
  return lod_reader_bad(rib->reader, "bad-syntax", "line %llu %s", (unsigned long long)rib->request_line, what);
}

/* ---- words ---- */

static void skip_blank(struct rib *rib) {
  while (rib->at < rib->end) {
    char c = *rib->at;
    if (c == '#') {
      while (rib->at < rib->end && *rib->at != '\n')
        rib->at++;
    } else if (c == ' ' || (c >= '\t' && c <= '\r')) {
      rib->line += c == '\n';
      rib->at++;
    } else {
      return;
    }
  }
}

static bool is_request_start(char c) {
  return (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z');
}

static void read_word(struct rib *rib, char word[WORD]) {
  size_t n = 0;
  while (rib->at < rib->end && (is_request_start(*rib->at) || (*rib->at >= '0' && *rib->at <= '9') || *rib->at == '_')) {
    if (n + 1 < WORD)
      word[n++] = *rib->at;
    rib->at++;
  }
  word[n] = 0;
}

static bool read_string(struct rib *rib, char word[WORD]) {
  skip_blank(rib);
  if (rib->at == rib->end || *rib->at != '"')
    return false;
  size_t n = 0;
  for (rib->at++; rib->at < rib->end && *rib->at != '"'; rib->at++) {
    rib->line += *rib->at == '\n';
    if (n + 1 < WORD)
      word[n++] = *rib->at;
  }
  word[n] = 0;
  if (rib->at == rib->end)
    return false;
  rib->at++;
  return true;
}

/* A number that "]" may follow at once. */
static bool read_number(struct rib *rib, double *value) {
  skip_blank(rib);
  const char *stop = rib->at;
  while (stop < rib->end && *stop != ']' && *stop != '[' && *stop != '"' && !(*stop == ' ' || (*stop >= '\t' && *stop <= '\r')))
    stop++;
  return stop > rib->at && lod_number_read(&rib->at, stop, value);
}

/* [ numbers ] into rib->numbers; numbers without brackets too, up to `bare`. */
static enum lod_status read_array(struct rib *rib, uint32_t bare) {
  rib->number_count = 0;
  skip_blank(rib);
  bool bracket = rib->at < rib->end && *rib->at == '[';
  rib->at += bracket;
  for (;;) {
    skip_blank(rib);
    if (rib->at == rib->end)
      return bracket ? lod_reader_bad(rib->reader, "truncated", "the file ends within the array in line %llu",
                                      (unsigned long long)rib->request_line)
                     : LOD_OK;
    if (bracket && *rib->at == ']') {
      rib->at++;
      return LOD_OK;
    }
    if (!bracket && rib->number_count == bare)
      return LOD_OK;
    if (rib->number_count == rib->number_room) {
      uint32_t room = 2 * rib->number_room + 256;
      double *grown = LOD_NEW(rib->reader->scratch, room, double);
      if (!grown)
        return lod_reader_memory(rib->reader);
      if (rib->number_count > 0)
        memcpy(grown, rib->numbers, rib->number_count * sizeof *grown);
      rib->numbers = grown;
      rib->number_room = room;
    }
    if (!read_number(rib, &rib->numbers[rib->number_count]))
      return bad(rib, "has an array with something that is no number");
    rib->number_count++;
  }
}

/* Anything that is no request: strings, arrays of either, numbers. */
static enum lod_status skip_arguments(struct rib *rib) {
  char ignored[WORD];
  for (;;) {
    skip_blank(rib);
    if (rib->at == rib->end || is_request_start(*rib->at))
      return LOD_OK;
    if (*rib->at == '"') {
      if (!read_string(rib, ignored))
        return lod_reader_bad(rib->reader, "truncated", "the file ends within a string");
    } else {
      rib->at++;
    }
  }
}

/* ---- transforms ---- */

static struct state *top(struct rib *rib) {
  return &rib->stack[rib->depth];
}

static enum lod_status push(struct rib *rib) {
  if (rib->depth + 1 == STACK)
    return lod_reader_fail(rib->reader, LOD_LIMIT, "limit-depth", "line %llu: more than %d nested transforms",
                           (unsigned long long)rib->request_line, STACK);
  rib->stack[rib->depth + 1] = rib->stack[rib->depth];
  rib->depth++;
  return LOD_OK;
}

static void concat(struct rib *rib, const double m[16]) {
  double product[16];
  lod_matrix_multiply(top(rib)->matrix, m, product);
  memcpy(top(rib)->matrix, product, sizeof product);
}

static enum lod_status transform(struct rib *rib, const char *word) {
  uint32_t count = strcmp(word, "Rotate") == 0 ? 4 : strcmp(word, "Translate") == 0 || strcmp(word, "Scale") == 0 ? 3 : 16;
  LOD_TRY(read_array(rib, count));
  const double *v = rib->numbers;
  if (rib->number_count != count)
    return bad(rib, "has a transform with a wrong number of numbers");
  double m[16];
  lod_matrix_identity(m);
  if (count == 16) {
    memcpy(m, v, sizeof m); /* row vectors in rows: the same memory as columns of column vectors */
    if (strcmp(word, "Transform") == 0)
      lod_matrix_identity(top(rib)->matrix);
  } else if (strcmp(word, "Translate") == 0) {
    memcpy(m + 12, v, 3 * sizeof *v);
  } else if (strcmp(word, "Scale") == 0) {
    m[0] = v[0], m[5] = v[1], m[10] = v[2];
  } else {
    double angle = v[0] * (3.14159265358979323846 / 180), length = sqrt(v[1] * v[1] + v[2] * v[2] + v[3] * v[3]);
    if (!(length > 0))
      return bad(rib, "turns around an axis of no length");
    double x = v[1] / length, y = v[2] / length, z = v[3] / length, c = cos(angle), s = sin(angle), t = 1 - c;
    double r[16] = {t * x * x + c,
                    t * x * y + s * z,
                    t * x * z - s * y,
                    0,
                    t * x * y - s * z,
                    t * y * y + c,
                    t * y * z + s * x,
                    0,
                    t * x * z + s * y,
                    t * y * z - s * x,
                    t * z * z + c,
                    0,
                    0,
                    0,
                    0,
                    1};
    memcpy(m, r, sizeof m);
  }
  if (!lod_matrix_is_finite(m))
    return bad(rib, "has a transform with a number that is not finite");
  concat(rib, m);
  return LOD_OK;
}

static enum lod_status read_basis(struct rib *rib) {
  for (int i = 0; i < 2; i++) {
    struct basis *basis = &top(rib)->basis[i];
    char name[WORD];
    double step;
    skip_blank(rib);
    if (rib->at < rib->end && *rib->at == '"') {
      size_t k = 0;
      if (!read_string(rib, name))
        return bad(rib, "has a basis without its name");
      while (k < sizeof kBases / sizeof *kBases && strcmp(kBases[k].name, name) != 0)
        k++;
      if (k == sizeof kBases / sizeof *kBases)
        return bad(rib, "names a basis that is not known");
      *basis = kBases[k].basis;
    } else {
      LOD_TRY(read_array(rib, 16));
      if (rib->number_count != 16)
        return bad(rib, "has a basis that is not 16 numbers");
      memcpy(basis->m, rib->numbers, sizeof basis->m);
    }
    if (!read_number(rib, &step) || !(step >= 1 && step <= 100))
      return bad(rib, "has a basis without its step");
    basis->step = (uint32_t)step;
  }
  return LOD_OK;
}

/* ---- patches ---- */

static struct lod_spline_point transformed(const struct rib *rib, const double *v, bool homogeneous) {
  const double *m = rib->stack[rib->depth].matrix;
  double w = homogeneous ? v[3] : 1;
  return (struct lod_spline_point){m[0] * v[0] + m[4] * v[1] + m[8] * v[2] + m[12] * w, m[1] * v[0] + m[5] * v[1] + m[9] * v[2] + m[13] * w,
                                   m[2] * v[0] + m[6] * v[1] + m[10] * v[2] + m[14] * w, w};
}

/* Reads parameters until the next request; the points are left in rib->numbers. */
static enum lod_status read_points(struct rib *rib, bool *homogeneous) {
  double *kept = NULL;
  uint32_t count = 0;
  char name[WORD];
  for (;;) {
    skip_blank(rib);
    if (rib->at == rib->end || *rib->at != '"')
      break;
    if (!read_string(rib, name))
      return bad(rib, "has a parameter without its name");
    skip_blank(rib);
    bool points = strcmp(name, "P") == 0 || strcmp(name, "Pw") == 0 || strcmp(name, "vertex point P") == 0;
    if (strcmp(name, "Pz") == 0)
      return lod_reader_fail(rib->reader, LOD_UNSUPPORTED, "patch-kind", "line %llu: patches given by heights (Pz) are not read",
                             (unsigned long long)rib->request_line);
    if (!points) {
      /* Strings or numbers. */
      if (rib->at < rib->end && *rib->at == '[')
        while (rib->at < rib->end && *rib->at != ']') {
          rib->line += *rib->at == '\n';
          rib->at++;
        }
      if (rib->at < rib->end)
        rib->at++;
      continue;
    }
    LOD_TRY(read_array(rib, 0));
    *homogeneous = strcmp(name, "Pw") == 0;
    kept = rib->numbers;
    count = rib->number_count;
    rib->number_room = 0; /* the array is kept */
  }
  rib->numbers = kept;
  rib->number_count = count;
  return kept == NULL ? bad(rib, "has a patch without P or Pw") : LOD_OK;
}

/* Inverse of the Bezier basis: power coefficients (powers 3, 2, 1, 0) to control points. */
static const double kToBezier[4][4] = {{0, 0, 0, 1}, {0, 0, 1 / 3.0, 1}, {0, 1 / 3.0, 2 / 3.0, 1}, {1, 1, 1, 1}};

static void basis_to_bezier(const struct basis *basis, double out[4][4]) {
  for (int i = 0; i < 4; i++)
    for (int j = 0; j < 4; j++) {
      out[i][j] = 0;
      for (int k = 0; k < 4; k++)
        out[i][j] += kToBezier[i][k] * basis->m[k][j];
    }
}

static void add_scaled(struct lod_spline_point *sum, double s, struct lod_spline_point p) {
  *sum = (struct lod_spline_point){sum->x + s * p.x, sum->y + s * p.y, sum->z + s * p.z, sum->w + s * p.w};
}

/* One patch of a grid of nu columns: window at (u, v), indices wrap. */
static enum lod_status add_window(struct rib *rib, const uint32_t size[2], const uint32_t at[2], bool cubic, bool homogeneous) {
  uint32_t order = cubic ? 4 : 2, degree[2] = {order - 1, order - 1};
  struct lod_spline_point window[4][4], *points = LOD_NEW(rib->reader->scratch, order * order, struct lod_spline_point);
  if (points == NULL)
    return lod_reader_memory(rib->reader);
  for (uint32_t v = 0; v < order; v++)
    for (uint32_t u = 0; u < order; u++) {
      uint32_t index = (at[1] + v) % size[1] * size[0] + (at[0] + u) % size[0];
      window[v][u] = transformed(rib, rib->numbers + (homogeneous ? 4 : 3) * (size_t)index, homogeneous);
    }
  if (!cubic) {
    memcpy(points, window[0], 2 * sizeof *points);
    memcpy(points + 2, window[1], 2 * sizeof *points);
    return lod_splines_add(&rib->splines, false, degree, points, rib->request_line);
  }
  double bu[4][4], bv[4][4];
  basis_to_bezier(&top(rib)->basis[0], bu);
  basis_to_bezier(&top(rib)->basis[1], bv);
  bool bezier = memcmp(&top(rib)->basis[0].m, &kBases[0].basis.m, sizeof bu) == 0 &&
                memcmp(&top(rib)->basis[1].m, &kBases[0].basis.m, sizeof bv) == 0;
  for (uint32_t i = 0; i < 4; i++)
    for (uint32_t j = 0; j < 4; j++) {
      struct lod_spline_point sum = {0, 0, 0, 0};
      for (uint32_t v = 0; v < 4; v++)
        for (uint32_t u = 0; u < 4; u++)
          add_scaled(&sum, bv[i][v] * bu[j][u], window[v][u]);
      points[4 * i + j] = bezier ? window[i][j] : sum; /* exactly as the file says, so that neighbours meet */
    }
  return lod_splines_add(&rib->splines, false, degree, points, rib->request_line);
}

static enum lod_status read_mesh(struct rib *rib, bool single) {
  char type[WORD], wrap[2][WORD] = {"nonperiodic", "nonperiodic"};
  uint32_t size[2], patches[2];
  if (!read_string(rib, type))
    return bad(rib, "has a patch without its type");
  bool cubic = strcmp(type, "bicubic") == 0, homogeneous = false;
  if (!cubic && strcmp(type, "bilinear") != 0)
    return bad(rib, "has a patch that is neither bilinear nor bicubic");
  size[0] = size[1] = cubic ? 4 : 2;
  for (int i = 0; i < 2 && !single; i++) {
    double count;
    if (!read_number(rib, &count) || !(count >= 2 && count <= 1e6) || !read_string(rib, wrap[i]))
      return bad(rib, "has a patch mesh without sizes and wraps");
    size[i] = (uint32_t)count;
  }
  LOD_TRY(read_points(rib, &homogeneous));
  if ((uint64_t)rib->number_count != (homogeneous ? 4 : 3) * (uint64_t)size[0] * size[1])
    return lod_reader_bad(rib->reader, "bad-syntax", "line %llu has a mesh of %u by %u points with %u numbers",
                          (unsigned long long)rib->request_line, size[0], size[1], rib->number_count);
  for (int i = 0; i < 2; i++) {
    uint32_t step = cubic ? top(rib)->basis[i].step : 1, order = cubic ? 4 : 2;
    bool periodic = strcmp(wrap[i], "periodic") == 0;
    if (size[i] < order && !periodic)
      return bad(rib, "has a mesh with fewer points than one patch needs");
    patches[i] = periodic ? size[i] / step : (size[i] - order) / step + 1;
  }
  for (uint32_t v = 0; v < patches[1]; v++)
    for (uint32_t u = 0; u < patches[0]; u++) {
      uint32_t at[2] = {u * (cubic ? top(rib)->basis[0].step : 1), v * (cubic ? top(rib)->basis[1].step : 1)};
      LOD_TRY(add_window(rib, size, at, cubic, homogeneous));
    }
  return LOD_OK;
}

/* ---- NURBS ---- */

/* Inserts knots until every inner one has multiplicity order - 1: then each span's control points are Bezier's. `count` points with stride
 * between them in rows of one direction; room for all. Returns the new count. */
static uint32_t insert_all(struct lod_spline_point *p, uint32_t stride, uint32_t count, uint32_t order, double *knots, uint32_t room) {
  uint32_t degree = order - 1;
  for (uint32_t k = order; k < count;) {
    uint32_t multiplicity = 0;
    while (k + multiplicity < count && knots[k + multiplicity] == knots[k])
      multiplicity++;
    for (; multiplicity < degree && count < room; multiplicity++) {
      double t = knots[k];
      uint32_t span = k + multiplicity - 1; /* knots[span] <= t < knots[span + 1], counting the copies there are */
      /* Boehm: new point i = a p[i] + (1 - a) p[i - 1] for span - degree < i <= span - (copies). */
      for (uint32_t i = count; i > span + 1 - multiplicity; i--)
        p[i * stride] = p[(i - 1) * stride];
      for (uint32_t i = span + 1 - multiplicity; i + degree > span && i > 0; i--) {
        double low = knots[i], high = knots[i + degree], a = high > low ? (t - low) / (high - low) : 0;
        struct lod_spline_point x = p[i * stride], y = p[(i - 1) * stride];
        p[i * stride] =
            (struct lod_spline_point){a * x.x + (1 - a) * y.x, a * x.y + (1 - a) * y.y, a * x.z + (1 - a) * y.z, a * x.w + (1 - a) * y.w};
      }
      for (uint32_t i = count + order; i > span + 1; i--)
        knots[i] = knots[i - 1];
      knots[span + 1] = t;
      count++;
    }
    k += multiplicity > degree ? multiplicity : degree;
  }
  return count;
}

struct nurbs {
  uint32_t count[2], order[2];
  double *knots[2];
};

static enum lod_status read_nurbs_head(struct rib *rib, struct nurbs *n) {
  for (int i = 0; i < 2; i++) {
    double count, order, ignored;
    if (!read_number(rib, &count) || !read_number(rib, &order) || !(order >= 2 && order <= MAX_ORDER) || !(count >= order && count <= 1e5))
      return bad(rib, "has a NURBS patch whose counts or orders are not known (orders 2 to 10)");
    n->count[i] = (uint32_t)count;
    n->order[i] = (uint32_t)order;
    LOD_TRY(read_array(rib, n->count[i] + n->order[i]));
    if (rib->number_count != n->count[i] + n->order[i])
      return bad(rib, "has a NURBS patch with a wrong number of knots");
    n->knots[i] = LOD_NEW(rib->reader->scratch, (size_t)n->count[i] * n->order[i] + 2 * n->order[i], double);
    if (n->knots[i] == NULL)
      return lod_reader_memory(rib->reader);
    memcpy(n->knots[i], rib->numbers, rib->number_count * sizeof(double));
    for (uint32_t k = 1; k < rib->number_count; k++)
      if (!(n->knots[i][k] >= n->knots[i][k - 1]))
        return bad(rib, "has knots that fall");
    double low = n->knots[i][0], high = n->knots[i][rib->number_count - 1];
    if (!(n->knots[i][n->order[i] - 1] == low && n->knots[i][n->count[i]] == high && high > low))
      return lod_reader_fail(rib->reader, LOD_UNSUPPORTED, "nurbs-open",
                             "line %llu has a NURBS patch whose end knots are not repeated; such ends are not read",
                             (unsigned long long)rib->request_line);
    for (int k = 0; k < 2; k++)
      if (!read_number(rib, &ignored))
        return bad(rib, "has a NURBS patch without its range");
  }
  return LOD_OK;
}

static enum lod_status read_nurbs(struct rib *rib) {
  struct nurbs n;
  bool homogeneous = false;
  LOD_TRY(read_nurbs_head(rib, &n));
  LOD_TRY(read_points(rib, &homogeneous));
  if ((uint64_t)rib->number_count != (homogeneous ? 4 : 3) * (uint64_t)n.count[0] * n.count[1])
    return bad(rib, "has a NURBS patch with a wrong number of points");
  uint32_t room[2] = {n.count[0] * (n.order[0] - 1) + n.order[0], n.count[1] * (n.order[1] - 1) + n.order[1]};
  uint64_t cells = (uint64_t)room[0] * room[1];
  LOD_TRY(lod_reader_add_vertices(rib->reader, cells));
  struct lod_spline_point *grid = LOD_NEW(rib->reader->scratch, cells, struct lod_spline_point);
  double *knots = LOD_NEW(rib->reader->scratch, (size_t)room[0] + room[1] + 2 * MAX_ORDER, double);
  if (grid == NULL || knots == NULL)
    return lod_reader_memory(rib->reader);
  for (uint32_t v = 0; v < n.count[1]; v++)
    for (uint32_t u = 0; u < n.count[0]; u++)
      grid[(size_t)v * room[0] + u] = transformed(rib, rib->numbers + (homogeneous ? 4 : 3) * ((size_t)v * n.count[0] + u), homogeneous);
  uint32_t wide = n.count[0], high = n.count[1];
  for (uint32_t v = 0; v < n.count[1]; v++) {
    memcpy(knots, n.knots[0], (n.count[0] + n.order[0]) * sizeof *knots);
    wide = insert_all(grid + (size_t)v * room[0], 1, n.count[0], n.order[0], knots, room[0]);
  }
  for (uint32_t u = 0; u < wide; u++) {
    memcpy(knots, n.knots[1], (n.count[1] + n.order[1]) * sizeof *knots);
    high = insert_all(grid + u, room[0], n.count[1], n.order[1], knots, room[1]);
  }
  uint32_t degree[2] = {n.order[1] - 1, n.order[0] - 1};
  for (uint32_t v = 0; v + degree[0] < high; v += degree[0])
    for (uint32_t u = 0; u + degree[1] < wide; u += degree[1]) {
      struct lod_spline_point *points = LOD_NEW(rib->reader->scratch, n.order[0] * n.order[1], struct lod_spline_point);
      if (points == NULL)
        return lod_reader_memory(rib->reader);
      for (uint32_t i = 0; i < n.order[1]; i++)
        memcpy(points + i * n.order[0], grid + (size_t)(v + i) * room[0] + u, n.order[0] * sizeof *points);
      LOD_TRY(lod_splines_add(&rib->splines, false, degree, points, rib->request_line));
    }
  return LOD_OK;
}

/* ---- requests ---- */

static enum lod_status request(struct rib *rib, const char *word) {
  bool begins = strcmp(word, "TransformBegin") == 0 || strcmp(word, "AttributeBegin") == 0;
  bool ends = strcmp(word, "TransformEnd") == 0 || strcmp(word, "AttributeEnd") == 0;
  if (begins)
    return push(rib);
  if (ends && rib->depth == 0)
    return bad(rib, "ends a block that was not begun");
  if (ends)
    rib->depth--;
  else if (strcmp(word, "WorldBegin") == 0 || strcmp(word, "Identity") == 0)
    lod_matrix_identity(top(rib)->matrix);
  else if (strcmp(word, "WorldEnd") == 0)
    rib->over = rib->splines.count > 0;
  else if (strcmp(word, "Translate") == 0 || strcmp(word, "Rotate") == 0 || strcmp(word, "Scale") == 0 || strcmp(word, "Transform") == 0 ||
           strcmp(word, "ConcatTransform") == 0)
    return transform(rib, word);
  else if (strcmp(word, "Basis") == 0)
    return read_basis(rib);
  else if (strcmp(word, "Patch") == 0 || strcmp(word, "PatchMesh") == 0)
    return read_mesh(rib, word[5] == 0);
  else if (strcmp(word, "NuPatch") == 0)
    return read_nurbs(rib);
  else if (strcmp(word, "TrimCurve") == 0)
    return lod_reader_fail(rib->reader, LOD_UNSUPPORTED, "trimmed-nurbs", "line %llu: trimmed NURBS are not read yet; untrimmed ones are",
                           (unsigned long long)rib->request_line);
  return LOD_OK;
}

enum lod_status lod_import_rib(struct lod_reader *reader) {
  struct rib *rib = LOD_NEW_ZERO(reader->scratch, 1, struct rib);
  if (rib == NULL)
    return lod_reader_memory(reader);
  rib->reader = reader;
  rib->splines.reader = reader;
  rib->at = (const char *)reader->bytes;
  rib->end = rib->at + reader->size;
  rib->line = rib->request_line = 1;
  lod_matrix_identity(rib->stack[0].matrix);
  rib->stack[0].basis[0] = rib->stack[0].basis[1] = kBases[0].basis;
  while (!rib->over) {
    char word[WORD];
    skip_blank(rib);
    if (rib->at == rib->end)
      break;
    rib->request_line = rib->line;
    if (!is_request_start(*rib->at))
      return bad(rib, "starts with something that is no request");
    rib->request_line = rib->line;
    read_word(rib, word);
    LOD_TRY(request(rib, word));
    LOD_TRY(skip_arguments(rib));
  }
  return lod_splines_finish(&rib->splines);
}
