/* Refinement: the paper's row in kind, the rates of splitting, and the time from request to last byte.
 * Arguments: [-p FOLDER] (pictures like the paper's Figures 3, 4, 5, 9, 10) [-c CLIENTS] [-n REQUESTS a client]; -n 0 leaves the daemon
 * out. The model is spot of the shared data simplified to about 902 triangles by meshoptimizer, or a torus of 896 where there is none.
 * Times of computing are processor time with memory warm; times of requests are wall time, with the machine's load said. */
#include <curl/curl.h>
#include <dirent.h>
#include <malloc.h>
#include <math.h>
#include <meshoptimizer.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "codec/export/picture.h"
#include "codec/export/ply.h"
#include "codec/export/png.h"
#include "core/mesh/adjacency.h"
#include "core/refine/doi.h"
#include "server/worker/refine.h"
#include "tests/data/ply.h"
#include "tests/data/shapes.h"

static double seconds(clockid_t clock) {
  struct timespec t;
  clock_gettime(clock, &t);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void must(bool good, const char *what) {
  if (!good) {
    fprintf(stderr, "refine_bench: %s\n", what);
    exit(1);
  }
}

static const char *picture_folder;

/* ---- the model ---- */

static struct lod_mesh simplified(const struct lod_mesh *mesh, uint32_t triangles, struct lod_arena *arena) {
  struct lod_mesh coarse = *mesh, welded;
  coarse.triangles = lod_arena_alloc(arena, mesh->triangle_count, sizeof *coarse.triangles);
  coarse.triangle_count =
      (uint32_t)(meshopt_simplify(coarse.triangles[0], mesh->triangles[0], 3 * (size_t)mesh->triangle_count, mesh->positions[0],
                                  mesh->vertex_count, sizeof *mesh->positions, 3 * (size_t)triangles, 1, 0, NULL) /
                 3);
  must(lod_mesh_weld(&coarse, arena, &welded, NULL) == LOD_OK, "out of memory");
  return welded;
}

static struct lod_mesh model(struct lod_arena *arena, const char **name) {
  char path[1024];
  struct lod_mesh file, welded;
  snprintf(path, sizeof path, "%s/models/scans/spot.ply", lod_shared_folder() != NULL ? lod_shared_folder() : ".");
  if (lod_ply_read(path, arena, &file) && lod_mesh_weld(&file, arena, &welded, NULL) == LOD_OK) {
    *name = "spot, simplified";
    return simplified(&welded, 902, arena);
  }
  *name = "torus";
  return lod_shape_torus(arena, 2, 0.8, 32, 14);
}

/* ---- outlines ---- */

struct segment {
  double a[2], b[2];
  bool outer; /* on the border of the shadow, not before or behind something */
};
struct outline {
  struct segment *list;
  uint32_t count;
  struct lod_mesh lines; /* the same, in space, as free edges */
};

static double facing(const struct lod_mesh *mesh, uint32_t t, struct lod_vec3 view) {
  struct lod_vec3 p[3];
  for (int k = 0; k < 3; k++)
    p[k] = lod_vec3_from_float(mesh->positions[mesh->triangles[t][k]]);
  return lod_vec3_dot(lod_vec3_cross(lod_vec3_subtract(p[1], p[0]), lod_vec3_subtract(p[2], p[0])), view);
}

/* The shadow of a mesh as a bitmap over [-1, 1] of the frame. */
enum { SHADOW = 1536 };
struct frame {
  struct lod_vec3 right, up;
  double x, y, half; /* middle and half width, in the picture's plane */
};

static void project(const struct frame *frame, const float *position, double p[2]) {
  struct lod_vec3 v = lod_vec3_from_float(position);
  p[0] = lod_vec3_dot(v, frame->right);
  p[1] = lod_vec3_dot(v, frame->up);
}

static double to_pixel(const struct frame *frame, double x, double middle) {
  return ((x - middle) / frame->half + 1) / 2 * SHADOW;
}

static uint8_t *shadow_of(const struct lod_mesh *mesh, const struct frame *frame, struct lod_arena *arena) {
  uint8_t *shadow = LOD_NEW_ZERO(arena, (size_t)SHADOW * SHADOW, uint8_t);
  must(shadow != NULL, "out of memory");
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    double p[3][2];
    for (int k = 0; k < 3; k++) {
      project(frame, mesh->positions[mesh->triangles[t][k]], p[k]);
      p[k][0] = to_pixel(frame, p[k][0], frame->x);
      p[k][1] = to_pixel(frame, p[k][1], frame->y);
    }
    int low[2], high[2];
    for (int i = 0; i < 2; i++) {
      low[i] = (int)fmax(0, floor(fmin(p[0][i], fmin(p[1][i], p[2][i]))));
      high[i] = (int)fmin(SHADOW - 1, ceil(fmax(p[0][i], fmax(p[1][i], p[2][i]))));
    }
    for (int y = low[1]; y <= high[1]; y++)
      for (int x = low[0]; x <= high[0]; x++) {
        bool left = true, right = true;
        for (int k = 0; k < 3; k++) {
          const double *a = p[k], *b = p[(k + 1) % 3];
          double side = (b[0] - a[0]) * (y + 0.5 - a[1]) - (b[1] - a[1]) * (x + 0.5 - a[0]);
          left &= side >= 0;
          right &= side <= 0;
        }
        shadow[(size_t)y * SHADOW + (size_t)x] |= left || right;
      }
  }
  return shadow;
}

static bool covered(const uint8_t *shadow, double x, double y) {
  return x >= 0 && y >= 0 && x < SHADOW && y < SHADOW && shadow[(size_t)y * SHADOW + (size_t)x];
}

/* Two pixels beside the segment's middle there is nothing, on one side. */
static bool is_outer(const struct segment *s, const struct frame *frame, const uint8_t *shadow) {
  double a[2] = {to_pixel(frame, s->a[0], frame->x), to_pixel(frame, s->a[1], frame->y)};
  double b[2] = {to_pixel(frame, s->b[0], frame->x), to_pixel(frame, s->b[1], frame->y)};
  double dx = b[0] - a[0], dy = b[1] - a[1], l = hypot(dx, dy), x = (a[0] + b[0]) / 2, y = (a[1] + b[1]) / 2;
  if (!(l > 0))
    return false;
  return !covered(shadow, x - 2 * dy / l, y + 2 * dx / l) || !covered(shadow, x + 2 * dy / l, y - 2 * dx / l);
}

/* Edges between front and back, as seen along -view: projected square to it. */
static struct outline outline_of(const struct lod_mesh *mesh, struct lod_vec3 view, const struct frame *frame, struct lod_arena *arena) {
  struct outline outline = {.list = LOD_NEW(arena, mesh->triangle_count * 3 + 1, struct segment)};
  struct lod_adjacency adjacency;
  const uint8_t *shadow = shadow_of(mesh, frame, arena);
  must(outline.list != NULL && lod_adjacency_create(mesh, arena, &adjacency) == LOD_OK, "out of memory");
  outline.lines = (struct lod_mesh){.vertex_count = mesh->vertex_count, .positions = mesh->positions};
  outline.lines.edges = lod_arena_alloc(arena, mesh->triangle_count * 3 + 1, sizeof *outline.lines.edges);
  for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++) {
    uint32_t twin = adjacency.twin[h];
    if (twin == LOD_NONE || h > twin || (facing(mesh, h / 3, view) >= 0) == (facing(mesh, twin / 3, view) >= 0))
      continue;
    uint32_t ends[2] = {lod_half_edge_start(mesh, h), lod_half_edge_end(mesh, h)};
    struct segment *segment = &outline.list[outline.count];
    memcpy(outline.lines.edges[outline.count++], ends, sizeof ends);
    project(frame, mesh->positions[ends[0]], segment->a);
    project(frame, mesh->positions[ends[1]], segment->b);
    segment->outer = is_outer(segment, frame, shadow);
  }
  outline.lines.edge_count = outline.count;
  return outline;
}

static double to_segment(const double p[2], const struct segment *s) {
  double dx = s->b[0] - s->a[0], dy = s->b[1] - s->a[1], l = dx * dx + dy * dy;
  double t = l > 0 ? ((p[0] - s->a[0]) * dx + (p[1] - s->a[1]) * dy) / l : 0;
  t = fmin(1, fmax(0, t));
  return hypot(p[0] - s->a[0] - t * dx, p[1] - s->a[1] - t * dy);
}

/* Largest distance of nine points a segment of `from` to `to`: a sample, so a lower bound. outer: of the shadow's border alone. */
static double one_way(const struct outline *from, const struct outline *to, bool outer) {
  double worst = 0;
  for (uint32_t i = 0; i < from->count; i++)
    for (int k = 0; k <= 8; k++) {
      const struct segment *s = &from->list[i];
      double p[2] = {s->a[0] + (s->b[0] - s->a[0]) * k / 8, s->a[1] + (s->b[1] - s->a[1]) * k / 8}, best = INFINITY;
      if (outer && !s->outer)
        break;
      for (uint32_t j = 0; j < to->count && best > worst; j++)
        best = outer && !to->list[j].outer ? best : fmin(best, to_segment(p, &to->list[j]));
      worst = fmax(worst, best);
    }
  return worst;
}

static double apart(const struct outline *a, const struct outline *b, bool outer) {
  return fmax(one_way(a, b, outer), one_way(b, a, outer));
}

/* ---- pictures ---- */

static void draw(const char *name, const struct lod_mesh *mesh, bool wires, double yaw) {
  struct lod_picture_settings settings = lod_picture_defaults();
  struct lod_picture picture;
  struct lod_arena *arena = lod_arena_create(0);
  char path[1024];
  settings.yaw_degrees = yaw;
  settings.pitch_degrees = 0;
  settings.wireframe = wires;
  snprintf(path, sizeof path, "%s/%s.png", picture_folder, name);
  must(lod_picture_render(mesh, 1, &settings, arena, &picture, NULL) == LOD_OK, "no picture");
  FILE *file = fopen(path, "wb");
  must(file != NULL && lod_png_write(&picture, file, NULL) == LOD_OK && fclose(file) == 0, path);
  lod_arena_destroy(arena);
}

enum { FRONT = 180 }; /* spot looks towards -z */

static void draw_outline(const char *name, struct outline *outline, double thickness, struct lod_arena *arena) {
  outline->lines.edge_thickness = LOD_NEW(arena, outline->count, float);
  for (uint32_t i = 0; i < outline->count; i++)
    outline->lines.edge_thickness[i] = (float)thickness;
  draw(name, &outline->lines, false, FRONT);
}

/* ---- the paper's row ---- */

static void paper(const struct lod_mesh *base, const char *name, struct lod_arena *arena) {
  static const struct {
    const char *name, *paper, *file;
    enum lod_doi_kind kind;
  } kRows[] = {{"uniform, 3 steps", "57 728", "figure5-full", LOD_DOI_UNIFORM},
               {"face angle 20 degrees", "26 872", "figure3a", LOD_DOI_FACE_ANGLE},
               {"silhouette edges", "11 188", "figure3b", LOD_DOI_SILHOUETTE},
               {"cone of limit normals", "-", "cone", LOD_DOI_CONE},
               {"static 30 degrees", "4 532", "figure4", LOD_DOI_DIHEDRAL}};
  struct lod_bounds bounds = lod_mesh_bounds(base);
  double diagonal = lod_bounds_diagonal(&bounds);
  struct lod_vec3 view = {0, 0, -1};
  struct frame frame = {{-1, 0, 0}, {0, 1, 0}, 0, 0, 0.55 * diagonal};
  frame.x = -(bounds.min[0] + bounds.max[0]) / 2;
  frame.y = (bounds.min[1] + bounds.max[1]) / 2;
  struct outline full = {0};
  printf("%s: %u triangles (the paper: 902), seen from the front\n", name, base->triangle_count);
  printf("%-24s %9s %8s %9s   outline's distance to the full one's, %% of the diagonal: outer, with those inside and hidden\n", "",
         "triangles", "of base", "paper");
  for (int scheme = 0; scheme < 2; scheme++)
    for (size_t i = 0; i < sizeof kRows / sizeof *kRows; i++) {
      struct lod_doi_term term = lod_doi_term_defaults(kRows[i].kind);
      term.view.parallel = true;
      term.view.direction[2] = -1;
      struct lod_doi doi = {.terms = &term, .term_count = 1};
      struct lod_refine_limits limits = lod_refine_limits_defaults();
      struct lod_refine_settings settings = lod_refine_defaults();
      struct lod_refine_output output;
      struct lod_refiner *refiner;
      settings.positions = scheme == 0 ? LOD_REFINE_LIMIT : LOD_REFINE_LEVEL;
      must(lod_refiner_create(base, &settings, arena, &refiner, NULL) == LOD_OK &&
               lod_refine_run(refiner, &doi, &limits, NULL, NULL) == LOD_OK && lod_refiner_mesh(refiner, arena, &output) == LOD_OK,
           "no refinement");
      struct outline outline = outline_of(&output.mesh, view, &frame, arena);
      if (i == 0)
        full = outline;
      printf("%-24s %9u %7.2fx %9s   %.4f %.4f%s\n", kRows[i].name, output.mesh.triangle_count,
             (double)output.mesh.triangle_count / base->triangle_count, kRows[i].paper, 100 * apart(&outline, &full, true) / diagonal,
             100 * apart(&outline, &full, false) / diagonal, i == 0 && scheme == 1 ? "  (level positions)" : "");
      must(i != 0 || output.mesh.triangle_count == 64 * base->triangle_count, "three uniform steps are not 64 times");
      if (picture_folder != NULL && scheme == 0) {
        char file[64];
        draw(kRows[i].file, &output.mesh, true, FRONT);
        snprintf(file, sizeof file, "figure5-outline-%s", kRows[i].file);
        draw_outline(file, &outline, 0.004 * diagonal, arena);
      }
      lod_refiner_destroy(refiner);
    }
  struct outline before = outline_of(base, view, &frame, arena);
  printf("%-24s %9u %7.2fx %9s   %.4f %.4f\n", "the base itself", base->triangle_count, 1.0, "902",
         100 * apart(&before, &full, true) / diagonal, 100 * apart(&before, &full, false) / diagonal);
}

/* Figures 9 and 10: patches that join, and an object in focus among others. */
static void figures(struct lod_arena *arena) {
  struct lod_mesh bone = lod_shape_tube(arena, 0.35, 3, 9, 5);
  for (uint32_t v = 0; v < bone.vertex_count; v++) { /* along y, with a knob at one end */
    float *p = bone.positions[v], z = p[2];
    float knob = z > 1 ? 1.7f + 0.25f * (float)(v % 3) : 1; /* uneven at one end */
    p[2] = p[1] * knob;
    p[0] *= knob;
    p[1] = z;
  }
  struct lod_mesh arm = lod_shape_tube(arena, 0.5, 4, 12, 8), ring = lod_shape_torus(arena, 0.62, 0.12, 14, 7),
                  ball = lod_shape_sphere(arena, 0.8, 1);
  struct lod_mesh two = lod_shape_join(arena, &arm, &ring, (const double[]){0, 0, 0.8});
  struct lod_mesh all = lod_shape_join(arena, &two, &ball, (const double[]){0, 0, -2.4});
  all.parts = LOD_NEW_ZERO(arena, all.triangle_count, uint32_t);
  for (uint32_t t = 0; t < all.triangle_count; t++)
    all.parts[t] = t < arm.triangle_count ? 0 : t < arm.triangle_count + ring.triangle_count ? 1 : 2;
  for (uint32_t v = 0; v < all.vertex_count; v++) { /* lying along x */
    float *p = all.positions[v], z = p[2];
    p[2] = -p[0];
    p[0] = z;
  }
  struct lod_doi_object bracelet;
  must(lod_doi_object_of_part(&all, 1, false, arena, &bracelet, NULL) == LOD_OK, "no bracelet");
  for (int figure = 9; figure <= 10; figure++) {
    struct lod_doi_term term = lod_doi_term_defaults(figure == 9 ? LOD_DOI_CLOUGH_TOCHER : LOD_DOI_FOCUS);
    term.objects = &bracelet;
    term.object_count = 1;
    term.falloff = 2.2;
    term.threshold = 1.5;
    struct lod_doi doi = {.terms = &term, .term_count = 1};
    struct lod_refine_limits limits = lod_refine_limits_defaults();
    struct lod_refiner *refiner;
    struct lod_refine_output output;
    must(lod_refiner_create(figure == 9 ? &bone : &all, NULL, arena, &refiner, NULL) == LOD_OK &&
             lod_refine_run(refiner, &doi, &limits, NULL, NULL) == LOD_OK && lod_refiner_mesh(refiner, arena, &output) == LOD_OK,
         "no refinement");
    draw(figure == 9 ? "figure9" : "figure10", &output.mesh, true, 0);
    lod_refiner_destroy(refiner);
  }
}

/* ---- exactness ---- */

struct triangle {
  float p[3][3];
};
static int compare_triangles(const void *a, const void *b) {
  return memcmp(a, b, sizeof(struct triangle));
}
static struct triangle triangle_at(const struct lod_mesh *mesh, uint32_t t) {
  struct triangle triangle;
  for (int k = 0; k < 3; k++)
    memcpy(triangle.p[k], mesh->positions[mesh->triangles[t][k]], sizeof triangle.p[k]);
  return triangle;
}

/* Triangles of an adaptive mesh that are looked for among those of the uniform one of their level; how many are not there. */
static uint32_t missing(const struct lod_mesh *base, const struct lod_refine_output *output, uint32_t level, struct lod_arena *arena,
                        uint32_t *compared) {
  struct lod_mesh uniform;
  uint32_t lost = 0;
  must(lod_refine_uniform(base, NULL, level, UINT64_MAX, arena, &uniform, NULL) == LOD_OK, "out of memory");
  struct triangle *list = LOD_NEW(arena, uniform.triangle_count, struct triangle);
  must(list != NULL, "out of memory");
  for (uint32_t t = 0; t < uniform.triangle_count; t++)
    list[t] = triangle_at(&uniform, t);
  qsort(list, uniform.triangle_count, sizeof *list, compare_triangles);
  for (uint32_t t = 0; t < output->mesh.triangle_count; t++) {
    if (output->levels[t] != level || output->green[t])
      continue;
    struct triangle triangle = triangle_at(&output->mesh, t);
    lost += bsearch(&triangle, list, uniform.triangle_count, sizeof triangle, compare_triangles) == NULL;
    (*compared)++;
  }
  return lost;
}

/* All scans of the shared data, refined at their outline: two steps where that is less than three million triangles, else one. */
static void exactness(void) {
  char path[1024];
  snprintf(path, sizeof path, "%s/models/scans", lod_shared_folder() != NULL ? lod_shared_folder() : ".");
  DIR *folder = opendir(path);
  uint32_t models = 0, compared = 0, lost = 0;
  for (struct dirent *entry; folder != NULL && (entry = readdir(folder)) != NULL;) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_mesh file, base;
    struct lod_refiner *refiner;
    struct lod_refine_output output;
    snprintf(path, sizeof path, "%s/models/scans/%s", lod_shared_folder(), entry->d_name);
    if (strstr(entry->d_name, ".ply") != NULL && lod_ply_read(path, arena, &file) && lod_mesh_weld(&file, arena, &base, NULL) == LOD_OK) {
      struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_SILHOUETTE);
      term.view.parallel = true;
      struct lod_doi doi = {.terms = &term, .term_count = 1};
      struct lod_refine_limits limits = lod_refine_limits_defaults();
      limits.steps = base.triangle_count < 190000 ? 2 : 1;
      must(lod_refiner_create(&base, NULL, arena, &refiner, NULL) == LOD_OK &&
               lod_refine_run(refiner, &doi, &limits, NULL, NULL) == LOD_OK && lod_refiner_surface(refiner, arena, &output) == LOD_OK,
           "out of memory");
      for (uint32_t level = 0; level <= limits.steps; level++)
        lost += missing(&base, &output, level, arena, &compared);
      lod_refiner_destroy(refiner);
      models++;
    }
    lod_arena_destroy(arena);
  }
  if (folder != NULL)
    closedir(folder);
  printf("\nexactness: %u scans refined at their outline; %u triangles looked for in the uniform mesh of their level, %u not there bit for "
         "bit\n",
         models, compared, lost);
  must(lost == 0, "adaptive is not uniform");
}

/* ---- rates ---- */

static void uniform_rate(void) {
  printf("\nuniform, positions on the limit, one thread (aim: 15 M output vertices/s)\n");
  for (int round = 0; round < 4; round++) {
    struct lod_arena *arena = lod_arena_create(0);
    struct lod_mesh base = lod_shape_torus(arena, 2, 0.5, 30, 15), mesh;
    double start = seconds(CLOCK_PROCESS_CPUTIME_ID);
    must(lod_refine_uniform(&base, NULL, 5, UINT64_MAX, arena, &mesh, NULL) == LOD_OK, "out of memory");
    double took = seconds(CLOCK_PROCESS_CPUTIME_ID) - start;
    printf("  %s %u vertices: %.1f M/s\n", round == 0 ? "memory cold," : "memory warm,", mesh.vertex_count,
           1e-6 * mesh.vertex_count / took);
    lod_arena_destroy(arena);
  }
}

static uint32_t split_level(struct lod_refiner *refiner, uint32_t face, uint32_t level) {
  uint32_t child = lod_refiner_face_children(refiner, face), count = 0;
  if (child == LOD_NONE)
    return lod_refiner_face_level(refiner, face) == level && lod_refiner_split(refiner, face);
  for (uint32_t k = 0; k < 4; k++)
    count += split_level(refiner, child + k, level);
  return count;
}
static uint32_t merge_level(struct lod_refiner *refiner, uint32_t face, uint32_t level) {
  uint32_t child = lod_refiner_face_children(refiner, face), count = 0;
  if (child == LOD_NONE)
    return 0;
  if (lod_refiner_face_level(refiner, face) == level)
    return lod_refiner_merge(refiner, face);
  for (uint32_t k = 0; k < 4; k++)
    count += merge_level(refiner, child + k, level);
  return count;
}

static void split_rate(struct lod_arena *arena) {
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.5, 30, 15);
  printf("\nsplits and merges, one thread (aim: 3 M/s); half of a torus of %u triangles, 4 levels down and up again\n",
         base.triangle_count);
  for (int life = 0; life < 2; life++) {
    struct lod_refiner *refiner;
    must(lod_refiner_create(&base, NULL, arena, &refiner, NULL) == LOD_OK, "out of memory");
    for (int round = 0; round < 3; round++) {
      uint32_t splits = 0, merges = 0;
      double start = seconds(CLOCK_PROCESS_CPUTIME_ID);
      for (uint32_t level = 0; level < 4; level++)
        for (uint32_t f = 0; f < base.triangle_count / 2; f++)
          splits += split_level(refiner, lod_refiner_base_face(refiner, f), level);
      double middle = seconds(CLOCK_PROCESS_CPUTIME_ID);
      for (uint32_t level = 4; level-- > 0;)
        for (uint32_t f = 0; f < base.triangle_count; f++) /* all: forced splits lie beside */
          merges += merge_level(refiner, lod_refiner_base_face(refiner, f), level);
      double end = seconds(CLOCK_PROCESS_CPUTIME_ID);
      printf("  %s: %.2f M splits/s, %.2f M merges/s, together %.2f M/s\n",
             round == 0 ? life == 0 ? "never split before, memory cold" : "never split before, memory warm" : "split before",
             1e-6 * splits / (middle - start), 1e-6 * merges / (end - middle), 1e-6 * (splits + merges) / (end - start));
    }
    lod_refiner_destroy(refiner);
  }
}

/* ---- one answer in the worker ---- */

/* What a worker does for one of the requests below, again and again with other eyes. */
static void answer_rate(struct lod_arena *arena, uint32_t rounds) {
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.8, 44, 20);
  double spent[4] = {0};
  uint64_t triangles = 0;
  struct lod_refiner *refiner;
  must(lod_refiner_create(&base, NULL, arena, &refiner, NULL) == LOD_OK, "out of memory");
  char *bytes = NULL;
  size_t size = 0;
  FILE *file = open_memstream(&bytes, &size);
  must(file != NULL && lod_ply_write(&base, NULL, file, NULL) == LOD_OK && fclose(file) == 0, "out of memory");
  struct lod_refine_base *whole;
  must(lod_refine_base_create("bench.ply", (const uint8_t *)bytes, size, 0, &whole, NULL) == LOD_OK, "no base");
  for (uint32_t i = 0; i < 2 * rounds; i++) { /* the first half makes the forest, and is not counted */
    double a = 0.0631 * (i % rounds) + (i < rounds ? 0 : 0.021), times[5];
    struct lod_doi_term term = lod_doi_term_defaults(LOD_DOI_FACE_ANGLE);
    memcpy(term.view.eye, (const double[]){5 * cos(a), 5 * sin(a), 3}, sizeof term.view.eye);
    term.degrees = 40;
    struct lod_doi doi = {.terms = &term, .term_count = 1};
    struct lod_refine_limits limits = lod_refine_limits_defaults();
    limits.steps = 4;
    limits.max_triangles = 50000;
    struct lod_refine_output output;
    struct lod_arena *scratch = lod_arena_create(0);
    times[0] = seconds(CLOCK_THREAD_CPUTIME_ID);
    lod_refiner_reset(refiner);
    times[1] = seconds(CLOCK_THREAD_CPUTIME_ID);
    must(lod_refine_run(refiner, &doi, &limits, NULL, NULL) == LOD_OK, "no refinement");
    times[2] = seconds(CLOCK_THREAD_CPUTIME_ID);
    must(lod_refiner_surface(refiner, scratch, &output) == LOD_OK, "no mesh");
    spent[2] += i >= rounds ? seconds(CLOCK_THREAD_CPUTIME_ID) - times[2] : 0;
    char text[3][32], parameter[LOD_REFINE_QUERY_PARAMETER + 1];
    struct lod_refine_query query;
    struct lod_problem problem = {0};
    struct lod_refine_answer answer;
    snprintf(text[0], sizeof text[0], "%.6f,%.6f,3", 5 * cos(a), 5 * sin(a));
    const struct lod_refine_parameter list[] = {{"doi", "silhouette"}, {"eye", text[0]}, {"angle", "40"}, {"steps", "4"}};
    must(lod_refine_query_parse(list, 4, false, &query, parameter, &problem) == LOD_OK, problem.detail);
    query.max_triangles = 50000;
    struct lod_refine_request request = {.query = &query, .max_triangles = 500000};
    times[3] = seconds(CLOCK_THREAD_CPUTIME_ID);
    must(lod_refine_answer(whole, &request, &answer, parameter, &problem) == LOD_OK, problem.detail);
    times[4] = seconds(CLOCK_THREAD_CPUTIME_ID);
    must(answer.triangles == output.mesh.triangle_count, "two ways, two counts");
    for (int k = 0; k < 4 && i >= rounds; k++)
      spent[k] += k == 2 ? 0 : times[k + 1] - times[k];
    triangles += i >= rounds ? output.mesh.triangle_count : 0;
    lod_arena_destroy(scratch);
    lod_refiner_pack(refiner, 0.25);
    lod_refine_base_tidy(whole, true);
  }
  printf("\none answer of %.0f triangles in a warm worker, processor time: %.2f ms (of which core: reset %.2f, run %.2f, mesh %.2f)\n",
         (double)triangles / rounds, 1e3 * spent[3] / rounds, 1e3 * spent[0] / rounds, 1e3 * spent[1] / rounds, 1e3 * spent[2] / rounds);
  lod_refine_base_destroy(whole);
  lod_refiner_destroy(refiner);
  free(bytes);
}

/* ---- request to last byte ---- */

/* Processor seconds of the daemon and of its workers. */
static double cpu_of(pid_t pid, bool children) {
  char path[64], text[1024];
  double sum = 0;
  unsigned long user = 0, kernel = 0;
  snprintf(path, sizeof path, "/proc/%d/stat", (int)pid);
  FILE *file = fopen(path, "r");
  if (file != NULL && fgets(text, sizeof text, file) != NULL && strrchr(text, ')') != NULL &&
      sscanf(strrchr(text, ')'), ") %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu", &user, &kernel) == 2)
    sum += (double)(user + kernel) / (double)sysconf(_SC_CLK_TCK);
  if (file != NULL)
    fclose(file);
  snprintf(path, sizeof path, "/proc/%d/task", (int)pid);
  DIR *tasks = children ? opendir(path) : NULL;
  for (struct dirent *task; tasks != NULL && (task = readdir(tasks)) != NULL;) {
    char list[400];
    snprintf(list, sizeof list, "/proc/%d/task/%.32s/children", (int)pid, task->d_name);
    int child;
    if ((file = fopen(list, "r")) == NULL)
      continue;
    while (fscanf(file, "%d", &child) == 1)
      sum += cpu_of(child, false);
    fclose(file);
  }
  if (tasks != NULL)
    closedir(tasks);
  return sum;
}

struct client {
  pthread_t thread;
  const char *url;
  uint32_t number, requests, failed;
  bool equal;   /* all clients ask the same */
  double pause; /* seconds from one request to the next; 0: at once */
  double *times;
  uint64_t bytes;
};

static size_t swallow(char *bytes, size_t size, size_t count, void *context) {
  (void)bytes;
  *(uint64_t *)context += size * count;
  return size * count;
}

static void *ask(void *argument) {
  struct client *client = argument;
  CURL *curl = curl_easy_init();
  char url[512];
  curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, swallow);
  curl_easy_setopt(curl, CURLOPT_WRITEDATA, &client->bytes);
  for (uint32_t i = 0; i < client->requests; i++) {
    /* Never the same twice, or the same as all others: each once. */
    double a = client->equal ? 0.0023 + 0.1 * i : 0.7 * client->number + 0.013 * i + (client->pause > 0 ? 0.0041 : 0);
    snprintf(url, sizeof url, "%s/v1/models/bench/refine?doi=silhouette&eye=%.6f,%.6f,3&angle=40&steps=4&max_triangles=50000", client->url,
             5 * cos(a), 5 * sin(a));
    curl_easy_setopt(curl, CURLOPT_URL, url);
    double start = seconds(CLOCK_MONOTONIC);
    long status = 0;
    if (curl_easy_perform(curl) != CURLE_OK || curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &status) != CURLE_OK || status != 200)
      client->failed++;
    client->times[i] = seconds(CLOCK_MONOTONIC) - start;
    double rest = client->pause - client->times[i];
    if (rest > 0)
      usleep((useconds_t)(1e6 * rest));
  }
  curl_easy_cleanup(curl);
  return NULL;
}

static int compare_times(const void *a, const void *b) {
  double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

static void clients(const char *url, pid_t pid, uint32_t count, uint32_t requests, bool equal, double pause, const char *what) {
  struct client list[64];
  double *times = calloc((size_t)count * requests, sizeof *times), load[3];
  uint64_t bytes = 0;
  uint32_t failed = 0;
  double cpu = cpu_of(pid, true);
  for (uint32_t i = 0; i < count; i++) {
    list[i] = (struct client){.url = url,
                              .number = count == 1 ? 9 : i,
                              .requests = requests,
                              .equal = equal,
                              .pause = pause,
                              .times = times + (size_t)i * requests};
    pthread_create(&list[i].thread, NULL, ask, &list[i]);
  }
  for (uint32_t i = 0; i < count; i++) {
    pthread_join(list[i].thread, NULL);
    bytes += list[i].bytes;
    failed += list[i].failed;
  }
  cpu = cpu_of(pid, true) - cpu;
  qsort(times, (size_t)count * requests, sizeof *times, compare_times);
  getloadavg(load, 3);
  printf("  %-34s p50 %6.1f ms, p99 %6.1f ms, %4.1f ms of processor a request, %u failed, %.0f kB each; load %.1f on %ld processors\n",
         what, 1e3 * times[(size_t)count * requests / 2], 1e3 * times[(size_t)count * requests * 99 / 100],
         1e3 * cpu / ((double)count * requests), failed, 1e-3 * (double)bytes / ((double)count * requests), load[0],
         sysconf(_SC_NPROCESSORS_ONLN));
  free(times);
}

static void requests(const char *program, uint32_t count, uint32_t each, struct lod_arena *arena) {
  char folder[] = "/tmp/refine-bench-XXXXXX", path[1100], daemon[1024], store[64], models[64], line[256] = "", url[128] = "";
  struct lod_mesh base = lod_shape_torus(arena, 2, 0.8, 44, 20);
  snprintf(daemon, sizeof daemon, "%.900s", program);
  char *slash = strstr(daemon, "/tests/bench/");
  must(slash != NULL && mkdtemp(folder) != NULL, "cannot find the daemon");
  strcpy(slash, "/lodestreamd");
  snprintf(store, sizeof store, "%s/store", folder);
  snprintf(models, sizeof models, "%s/models", folder);
  mkdir(models, 0700);
  snprintf(path, sizeof path, "%s/bench.ply", models);
  FILE *file = fopen(path, "wb");
  must(file != NULL && lod_ply_write(&base, NULL, file, NULL) == LOD_OK && fclose(file) == 0, path);
  int out[2];
  must(pipe(out) == 0, "pipe");
  pid_t pid = fork();
  if (pid == 0) {
    dup2(out[1], 1);
    if (freopen("/dev/null", "w", stderr) == NULL)
      _exit(127);
    execl(daemon, daemon, "--store", store, "--listen", "127.0.0.1:0", "--models", models, "--later-families", "", "--log-level", "off",
          NULL);
    _exit(127);
  }
  FILE *said = fdopen(out[0], "r");
  must(fgets(line, sizeof line, said) != NULL && sscanf(line, "listening on %127s", url) == 1, "the daemon did not start");
  curl_global_init(CURL_GLOBAL_ALL);
  snprintf(path, sizeof path, "%s/v1/models/bench", url);
  for (int i = 0; i < 600; i++) {
    CURL *curl = curl_easy_init();
    uint64_t bytes = 0;
    long status = 0;
    curl_easy_setopt(curl, CURLOPT_URL, path);
    curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, swallow);
    curl_easy_setopt(curl, CURLOPT_WRITEDATA, &bytes);
    if (curl_easy_perform(curl) == CURLE_OK)
      curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &status);
    curl_easy_cleanup(curl);
    if (status == 200)
      break;
    usleep(200000);
  }
  printf("\nrequest to last byte, 50 000 triangles of %u, %u clients, two workers (aim: p50 < 20 ms, p99 < 100 ms)\n", base.triangle_count,
         count);
  clients(url, pid, count, 8, false, 0, "first (bases and forests are made)");
  clients(url, pid, count, each, false, 0, "one request after the other");
  clients(url, pid, count, each, false, 0.5, "two requests a second each");
  clients(url, pid, 1, each, false, 0.05, "one client, 20 requests a second");
  clients(url, pid, count, each, true, 0, "all clients ask the same");
  clients(url, pid, count, each, true, 0, "and all the same once more");
  kill(pid, SIGTERM);
  waitpid(pid, NULL, 0);
  snprintf(path, sizeof path, "rm -rf %s", folder);
  must(system(path) == 0, path);
}

int main(int argc, char **argv) {
  uint32_t count = 8, each = 40;
  for (int i = 1; i + 1 < argc; i += 2) {
    if (strcmp(argv[i], "-p") == 0)
      picture_folder = argv[i + 1];
    else if (strcmp(argv[i], "-c") == 0)
      count = (uint32_t)atoi(argv[i + 1]);
    else if (strcmp(argv[i], "-n") == 0)
      each = (uint32_t)atoi(argv[i + 1]);
  }
  must(count >= 1 && count <= 64, "-c is 1 to 64");
  mallopt(M_MMAP_MAX, 0); /* memory that was freed stays: rates are of computing, not of the kernel's pages */
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  setvbuf(stdout, NULL, _IOLBF, 0);
  struct lod_arena *arena = lod_arena_create(0);
  const char *name;
  struct lod_mesh base = model(arena, &name);
  paper(&base, name, arena);
  if (picture_folder != NULL)
    figures(arena);
  exactness();
  uniform_rate();
  split_rate(arena);
  answer_rate(arena, 40);
  if (each != 0)
    requests(argv[0], count, each, arena);
  lod_arena_destroy(arena);
  return 0;
}
