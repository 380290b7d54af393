/* A small software rasteriser: edge functions and perspective-correct barycentrics (Pineda. A Parallel Algorithm for Polygon
 * Rasterization. 1988), capsules for thick edges, two lights. */
#include "codec/export/picture.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/base/tolerance.h"

#define PI 3.14159265358979323846

enum { SAMPLES = 2 }; /* each way */

struct lod_picture_settings lod_picture_defaults(void) {
  return (struct lod_picture_settings){
      .width = 800, .height = 800, .yaw_degrees = 35, .pitch_degrees = 20, .up_axis = 1, .fov_degrees = 35};
}

struct sample {
  float color[3]; /* linear */
  float nearness; /* 1 / depth; 0 = background */
};

struct canvas {
  const struct lod_picture_settings *settings;
  uint32_t width, height; /* samples */
  struct sample *samples;
  /* view = rotation * (p - eye); x right, y up, z towards the viewer. */
  struct lod_vec3 right, up, back, eye;
  double focal; /* samples at unit depth */
  double near;
  double least_radius; /* of an edge or point, samples */
};

/* ---- camera ---- */

static struct lod_vec3 oriented(int up_axis, double x, double y, double z) {
  return up_axis == 2 ? lod_vec3_make(x, -z, y) : lod_vec3_make(x, y, z);
}

static void aim(struct canvas *canvas, const struct lod_sphere *frame) {
  const struct lod_picture_settings *s = canvas->settings;
  const double yaw = s->yaw_degrees * PI / 180, pitch = s->pitch_degrees * PI / 180, half = s->fov_degrees * PI / 360;
  canvas->back = oriented(s->up_axis, sin(yaw) * cos(pitch), sin(pitch), cos(yaw) * cos(pitch));
  canvas->right = oriented(s->up_axis, cos(yaw), 0, -sin(yaw));
  canvas->up = lod_vec3_cross(canvas->back, canvas->right);
  /* The narrower way decides; 4 % of margin. */
  const double narrow = canvas->width < canvas->height ? atan(tan(half) * canvas->width / canvas->height) : half;
  const double radius = frame->radius > 0 ? frame->radius : 1, distance = 1.04 * radius / sin(narrow);
  const struct lod_vec3 centre = lod_vec3_make(frame->center[0], frame->center[1], frame->center[2]);
  canvas->eye = lod_vec3_add_scaled(centre, canvas->back, distance);
  canvas->near = distance * 1e-3;
  canvas->focal = canvas->height / 2.0 / tan(half);
  canvas->least_radius = 0.6 * SAMPLES;
}

struct projected {
  double x, y, nearness; /* samples; 0 = behind the near plane */
};

static struct projected project(const struct canvas *canvas, struct lod_vec3 p) {
  const struct lod_vec3 d = lod_vec3_subtract(p, canvas->eye);
  const double depth = -lod_vec3_dot(d, canvas->back);
  if (!(depth > canvas->near))
    return (struct projected){0};
  return (struct projected){canvas->width / 2.0 + canvas->focal * lod_vec3_dot(d, canvas->right) / depth,
                            canvas->height / 2.0 - canvas->focal * lod_vec3_dot(d, canvas->up) / depth, 1 / depth};
}

/* ---- colour ---- */

/* A sky light from above and a lamp over the viewer's left shoulder; surfaces have two sides. normal: unit. */
static void shade(const struct canvas *canvas, struct lod_vec3 normal, const float base[3], float out[3]) {
  if (lod_vec3_dot(normal, canvas->back) < 0)
    normal = lod_vec3_scale(normal, -1);
  struct lod_vec3 lamp = lod_vec3_add_scaled(lod_vec3_add_scaled(canvas->back, canvas->up, 0.7), canvas->right, -0.5);
  lamp = lod_vec3_normalize(lamp);
  const double sky = 0.5 + 0.5 * lod_vec3_dot(normal, canvas->up), direct = fmax(lod_vec3_dot(normal, lamp), 0);
  const struct lod_vec3 halfway = lod_vec3_normalize(lod_vec3_add(lamp, canvas->back));
  const double gloss = 0.12 * pow(fmax(lod_vec3_dot(normal, halfway), 0), 40);
  for (int i = 0; i < 3; i++)
    out[i] = (float)fmin((double)base[i] * (0.06 + 0.2 * sky + 0.9 * direct) + gloss, 1);
}

/* Blue, cyan, green, yellow, red, in linear light. */
static void heat_color(double value, float out[3]) {
  static const float kStops[5][3] = {
      {0.02f, 0.05f, 0.5f}, {0.0f, 0.45f, 0.6f}, {0.05f, 0.5f, 0.08f}, {0.85f, 0.7f, 0.02f}, {0.7f, 0.01f, 0.01f}};
  const double at = fmin(fmax(value, 0), 1) * 4;
  const int stop = at >= 4 ? 3 : (int)at;
  for (int i = 0; i < 3; i++)
    out[i] = (float)((double)kStops[stop][i] + (at - stop) * (double)(kStops[stop + 1][i] - kStops[stop][i]));
}

static const float kClay[3] = {0.55f, 0.53f, 0.5f};

static void material_color(const struct lod_picture_settings *s, uint32_t material, bool has_own, float out[3]) {
  static const float kWhite[3] = {1, 1, 1};
  memcpy(out, has_own ? kWhite : kClay, 3 * sizeof *out);
  if (s->material_colors != NULL && material < s->material_color_count)
    for (int i = 0; i < 3; i++)
      out[i] = s->material_colors[material][i];
}

/* ---- triangles ---- */

struct corner {
  struct projected at;
  struct lod_vec3 normal;
  float color[3];
};

static double edge_function(const struct projected *a, const struct projected *b, double x, double y) {
  return (b->x - a->x) * (y - a->y) - (b->y - a->y) * (x - a->x);
}

static void put(struct canvas *canvas, uint32_t x, uint32_t y, double nearness, const float color[3]) {
  struct sample *sample = &canvas->samples[(size_t)y * canvas->width + x];
  if ((float)nearness <= sample->nearness)
    return;
  sample->nearness = (float)nearness;
  memcpy(sample->color, color, sizeof sample->color);
}

/* First and last sample whose centre may lie in [low, high]. */
static bool span(double low, double high, uint32_t size, uint32_t *first, uint32_t *last) {
  if (!(high >= 0.5) || !(low <= size - 0.5))
    return false;
  *first = low <= 0.5 ? 0 : (uint32_t)ceil(low - 0.5);
  *last = high >= size - 0.5 ? size - 1 : (uint32_t)floor(high - 0.5);
  return *first <= *last;
}

static void draw_triangle(struct canvas *canvas, const struct corner corner[3]) {
  const struct projected *a = &corner[0].at, *b = &corner[1].at, *c = &corner[2].at;
  const double area = edge_function(a, b, c->x, c->y);
  uint32_t x0, x1, y0, y1;
  if (area == 0 || !span(fmin(a->x, fmin(b->x, c->x)), fmax(a->x, fmax(b->x, c->x)), canvas->width, &x0, &x1) ||
      !span(fmin(a->y, fmin(b->y, c->y)), fmax(a->y, fmax(b->y, c->y)), canvas->height, &y0, &y1))
    return;
  /* Lines of constant width: weight / gradient is the distance to the opposite edge in samples. */
  const double length[3] = {hypot(c->x - b->x, c->y - b->y), hypot(a->x - c->x, a->y - c->y), hypot(b->x - a->x, b->y - a->y)};
  for (uint32_t y = y0; y <= y1; y++)
    for (uint32_t x = x0; x <= x1; x++) {
      const double px = x + 0.5, py = y + 0.5;
      double w[3] = {edge_function(b, c, px, py) / area, edge_function(c, a, px, py) / area, edge_function(a, b, px, py) / area};
      if (w[0] < 0 || w[1] < 0 || w[2] < 0)
        continue;
      const double nearness = w[0] * a->nearness + w[1] * b->nearness + w[2] * c->nearness;
      if ((float)nearness <= canvas->samples[(size_t)y * canvas->width + x].nearness)
        continue;
      double line = INFINITY;
      for (int i = 0; i < 3; i++)
        line = fmin(line, w[i] * fabs(area) / length[i]);
      struct lod_vec3 normal = {0};
      float base[3] = {0, 0, 0}, color[3];
      for (int i = 0; i < 3; i++) {
        const double share = w[i] * corner[i].at.nearness / nearness;
        normal = lod_vec3_add_scaled(normal, corner[i].normal, share);
        for (int k = 0; k < 3; k++)
          base[k] += (float)share * corner[i].color[k];
      }
      shade(canvas, lod_vec3_normalize(normal), base, color);
      if (canvas->settings->wireframe && line < 0.45 * SAMPLES)
        for (int k = 0; k < 3; k++)
          color[k] *= 0.15f;
      put(canvas, x, y, nearness, color);
    }
}

/* ---- edges and points ---- */

/* A capsule between two projected ends of radii in samples; a ball when they are one point. */
static void draw_capsule(struct canvas *canvas, struct projected a, struct projected b, double radius_a, double radius_b,
                         const float base[3]) {
  const double largest = fmax(radius_a, radius_b), dx = b.x - a.x, dy = b.y - a.y, squared = dx * dx + dy * dy;
  uint32_t x0, x1, y0, y1;
  if (a.nearness == 0 || b.nearness == 0 || !span(fmin(a.x, b.x) - largest, fmax(a.x, b.x) + largest, canvas->width, &x0, &x1) ||
      !span(fmin(a.y, b.y) - largest, fmax(a.y, b.y) + largest, canvas->height, &y0, &y1))
    return;
  for (uint32_t y = y0; y <= y1; y++)
    for (uint32_t x = x0; x <= x1; x++) {
      const double px = x + 0.5 - a.x, py = y + 0.5 - a.y;
      const double t = squared > 0 ? fmin(fmax((px * dx + py * dy) / squared, 0), 1) : 0;
      const double ox = px - t * dx, oy = py - t * dy, radius = radius_a + t * (radius_b - radius_a), off = hypot(ox, oy);
      if (off > radius)
        continue;
      const double out = sqrt(fmax(1 - off * off / (radius * radius), 0));
      const struct lod_vec3 normal = lod_vec3_add_scaled(
          lod_vec3_add(lod_vec3_scale(canvas->right, ox / radius), lod_vec3_scale(canvas->up, -oy / radius)), canvas->back, out);
      const double nearness = a.nearness + t * (b.nearness - a.nearness);
      /* The surface bulges towards the eye by radius * out, in model units radius / focal * depth. */
      const double bulged = 1 / fmax(1 / nearness - radius * out / canvas->focal / nearness, canvas->near);
      float color[3];
      shade(canvas, lod_vec3_normalize(normal), base, color);
      put(canvas, x, y, bulged, color);
    }
}

static double radius_of(const struct canvas *canvas, float thickness, struct projected at) {
  return fmax((double)thickness / 2 * canvas->focal * at.nearness, canvas->least_radius);
}

static void draw_edges_and_points(struct canvas *canvas, const struct lod_mesh *mesh) {
  float base[3];
  for (uint32_t e = 0; e < mesh->edge_count; e++) {
    const struct projected a = project(canvas, lod_vec3_from_float(mesh->positions[mesh->edges[e][0]]));
    const struct projected b = project(canvas, lod_vec3_from_float(mesh->positions[mesh->edges[e][1]]));
    const float thickness = mesh->edge_thickness != NULL ? mesh->edge_thickness[e] : 0;
    material_color(canvas->settings, mesh->edge_materials != NULL ? mesh->edge_materials[e] : LOD_NONE, false, base);
    draw_capsule(canvas, a, b, radius_of(canvas, thickness, a), radius_of(canvas, thickness, b), base);
  }
  for (uint32_t p = 0; p < mesh->point_count; p++) {
    const struct projected a = project(canvas, lod_vec3_from_float(mesh->positions[mesh->points[p]]));
    material_color(canvas->settings, mesh->point_materials != NULL ? mesh->point_materials[p] : LOD_NONE, false, base);
    const double radius = radius_of(canvas, mesh->point_thickness != NULL ? mesh->point_thickness[p] : 0, a);
    draw_capsule(canvas, a, a, radius, radius, base);
  }
}

/* ---- normals ---- */

static struct lod_vec3 face_cross(const struct lod_mesh *mesh, uint32_t t) {
  const uint32_t *v = mesh->triangles[t];
  const struct lod_vec3 a = lod_vec3_from_float(mesh->positions[v[0]]);
  return lod_vec3_cross(lod_vec3_subtract(lod_vec3_from_float(mesh->positions[v[1]]), a),
                        lod_vec3_subtract(lod_vec3_from_float(mesh->positions[v[2]]), a));
}

/* The triangles around each vertex, and every triangle's normal, longer for larger triangles. */
struct around {
  uint32_t *begin; /* vertex_count + 1 */
  uint32_t *triangles;
  struct lod_vec3 *crosses;
};

static bool find_around(const struct lod_mesh *mesh, struct lod_arena *arena, struct around *around) {
  around->begin = LOD_NEW_ZERO(arena, (size_t)mesh->vertex_count + 2, uint32_t);
  around->triangles = lod_arena_alloc(arena, mesh->triangle_count, 3 * sizeof *around->triangles);
  around->crosses = LOD_NEW(arena, mesh->triangle_count, struct lod_vec3);
  if (around->begin == NULL || around->triangles == NULL || around->crosses == NULL)
    return false;
  uint32_t *end = around->begin + 1; /* shifted by one while filling: begin[v + 1] is where v's next goes */
  for (uint32_t t = 0; t < mesh->triangle_count; t++)
    for (int c = 0; c < 3; c++)
      end[mesh->triangles[t][c] + 1]++;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    end[v + 1] += end[v];
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    around->crosses[t] = face_cross(mesh, t);
    for (int c = 0; c < 3; c++)
      around->triangles[end[mesh->triangles[t][c]]++] = t;
  }
  return true;
}

enum { MOST_AROUND = 256 }; /* the tip of a fan has no normal to speak of, and summing would be quadratic */

/* Mean of the triangles around the corner that make no crease with this one. */
static struct lod_vec3 creased_normal(const struct lod_mesh *mesh, const struct around *around, uint32_t t, int c) {
  const uint32_t v = mesh->triangles[t][c];
  const struct lod_vec3 face = lod_vec3_normalize(around->crosses[t]);
  if (around->begin[v + 1] - around->begin[v] > MOST_AROUND)
    return face;
  struct lod_vec3 sum = {0};
  for (uint32_t i = around->begin[v]; i < around->begin[v + 1]; i++) {
    const struct lod_vec3 other = around->crosses[around->triangles[i]];
    if (lod_vec3_dot(other, face) >= cos(LOD_TOLERANCE_CREASE_DEGREES * PI / 180) * lod_vec3_length(other))
      sum = lod_vec3_add(sum, other);
  }
  return lod_vec3_normalize(sum);
}

static struct lod_vec3 corner_normal(const struct canvas *canvas, const struct lod_mesh *mesh, const struct around *around, uint32_t t,
                                     int c) {
  if (canvas->settings->flat)
    return lod_vec3_normalize(around->crosses[t]);
  if (mesh->normals != NULL) {
    const struct lod_vec3 own = lod_vec3_from_float(mesh->normals[mesh->corners[t][c]]);
    if (lod_vec3_length_squared(own) > 0.25)
      return own;
  }
  return creased_normal(mesh, around, t, c);
}

static enum lod_status draw_mesh(struct canvas *canvas, const struct lod_mesh *mesh, const double *heat, struct lod_arena *scratch) {
  struct around around;
  if (!find_around(mesh, scratch, &around))
    return LOD_MEMORY;
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    struct corner corner[3];
    bool visible = true;
    for (int c = 0; c < 3; c++) {
      const uint32_t v = mesh->triangles[t][c];
      corner[c].at = project(canvas, lod_vec3_from_float(mesh->positions[v]));
      visible = visible && corner[c].at.nearness > 0;
      corner[c].normal = corner_normal(canvas, mesh, &around, t, c);
      const bool own = mesh->colors != NULL;
      material_color(canvas->settings, mesh->materials != NULL ? mesh->materials[t] : LOD_NONE, own, corner[c].color);
      for (int k = 0; k < 3 && own; k++)
        corner[c].color[k] *= mesh->colors[mesh->corners[t][c]][k];
      if (heat != NULL)
        heat_color(canvas->settings->heat_max > 0 ? heat[v] / canvas->settings->heat_max : 0, corner[c].color);
    }
    if (visible)
      draw_triangle(canvas, corner);
  }
  draw_edges_and_points(canvas, mesh);
  return LOD_OK;
}

/* ---- from samples to pixels ---- */

static uint8_t to_srgb(double linear) {
  const double v = linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
  return (uint8_t)floor(fmin(fmax(v, 0), 1) * 255 + 0.5);
}

static void resolve(const struct canvas *canvas, struct lod_picture *picture) {
  for (uint32_t y = 0; y < picture->height; y++) {
    const double sky = 0.78 - 0.28 * y / picture->height; /* the background, lighter above */
    for (uint32_t x = 0; x < picture->width; x++) {
      double sum[3] = {0, 0, 0};
      for (uint32_t sy = 0; sy < SAMPLES; sy++)
        for (uint32_t sx = 0; sx < SAMPLES; sx++) {
          const struct sample *sample = &canvas->samples[(size_t)(y * SAMPLES + sy) * canvas->width + x * SAMPLES + sx];
          for (int k = 0; k < 3; k++)
            sum[k] += sample->nearness > 0 ? (double)sample->color[k] : sky;
        }
      uint8_t *pixel = picture->rgba[(size_t)y * picture->width + x];
      for (int k = 0; k < 3; k++)
        pixel[k] = to_srgb(sum[k] / (SAMPLES * SAMPLES));
      pixel[3] = 255;
    }
  }
}

/* ---- legend ---- */

/* 3 x 5 pixels a sign, rows from the top, three bits each. */
static const struct {
  char sign;
  uint16_t rows;
} kFont[] = {{'0', 075557}, {'1', 026227}, {'2', 071747}, {'3', 071717}, {'4', 055711}, {'5', 074717}, {'6', 074757},
             {'7', 071222}, {'8', 075757}, {'9', 075717}, {'.', 000002}, {'-', 000700}, {'+', 002720}, {'e', 007743}};

static void draw_text(struct lod_picture *picture, const char *text, int64_t left, int64_t top, int scale) {
  for (; *text != '\0'; text++, left += 4 * scale) {
    uint16_t rows = 0;
    for (size_t i = 0; i < sizeof kFont / sizeof *kFont; i++)
      if (kFont[i].sign == *text)
        rows = kFont[i].rows;
    for (int bit = 0; bit < 15; bit++) {
      if ((rows >> (14 - bit) & 1) == 0)
        continue;
      for (int dy = 0; dy < scale; dy++)
        for (int dx = 0; dx < scale; dx++) {
          const int64_t x = left + bit % 3 * scale + dx, y = top + bit / 3 * scale + dy;
          if (x >= 0 && y >= 0 && x < picture->width && y < picture->height)
            memset(picture->rgba[(size_t)y * picture->width + (size_t)x], 30, 3);
        }
    }
  }
}

/* A bar at the right edge, its ends' numbers above and below. */
static void draw_legend(struct lod_picture *picture, double heat_max) {
  const int scale = (int)(picture->height / 400) + 1;
  const int64_t bar = picture->height / 2, width = picture->width / 40 + 1, right = (int64_t)picture->width - width / 2,
                top = picture->height / 4;
  for (int64_t y = 0; y < bar; y++) {
    float color[3];
    heat_color(1 - (double)y / (double)bar, color);
    for (int64_t x = right - width < 0 ? 0 : right - width; x < right; x++) {
      uint8_t *pixel = picture->rgba[(size_t)(top + y) * picture->width + (size_t)x];
      for (int k = 0; k < 3; k++)
        pixel[k] = to_srgb((double)color[k]);
    }
  }
  char text[32];
  snprintf(text, sizeof text, "%.3g", heat_max);
  draw_text(picture, text, right - 4 * scale * (int64_t)strlen(text) + scale, top - 7 * scale, scale);
  draw_text(picture, "0", right - 3 * scale, top + bar + 2 * scale, scale);
}

/* ---- the whole ---- */

static struct lod_sphere own_sphere(const struct lod_mesh *meshes, uint32_t count) {
  struct lod_bounds all = {{0}, {0}};
  bool any = false;
  for (uint32_t m = 0; m < count; m++) {
    if (meshes[m].vertex_count == 0)
      continue;
    const struct lod_bounds bounds = lod_mesh_bounds(&meshes[m]);
    for (int i = 0; i < 3; i++) {
      all.min[i] = any ? fmin(all.min[i], bounds.min[i]) : bounds.min[i];
      all.max[i] = any ? fmax(all.max[i], bounds.max[i]) : bounds.max[i];
    }
    any = true;
  }
  struct lod_sphere sphere = {.radius = 0};
  for (int i = 0; i < 3; i++)
    sphere.center[i] = (all.min[i] + all.max[i]) / 2;
  /* Around the box's centre, but only as far as vertices go: the sphere around the box would leave wide margins. */
  for (uint32_t m = 0; m < count; m++)
    for (uint32_t v = 0; v < meshes[m].vertex_count; v++) {
      const struct lod_vec3 centre = lod_vec3_make(sphere.center[0], sphere.center[1], sphere.center[2]);
      sphere.radius = fmax(sphere.radius, lod_vec3_distance(lod_vec3_from_float(meshes[m].positions[v]), centre));
    }
  return sphere;
}

enum lod_status lod_picture_render(const struct lod_mesh *meshes, uint32_t mesh_count, const struct lod_picture_settings *settings,
                                   struct lod_arena *arena, struct lod_picture *picture, struct lod_problem *problem) {
  if (settings->width < 1 || settings->height < 1 || settings->width > LOD_PICTURE_MAX_SIDE || settings->height > LOD_PICTURE_MAX_SIDE)
    return lod_fail(problem, LOD_BAD_INPUT, "picture-size", "A picture of %u x %u pixels; 1 to %d each way are possible", settings->width,
                    settings->height, LOD_PICTURE_MAX_SIDE);
  struct lod_arena *scratch = lod_arena_create_child(arena);
  struct canvas canvas = {.settings = settings, .width = SAMPLES * settings->width, .height = SAMPLES * settings->height};
  *picture = (struct lod_picture){.width = settings->width, .height = settings->height};
  picture->rgba = lod_arena_alloc(arena, (size_t)settings->width * settings->height, sizeof *picture->rgba);
  canvas.samples = scratch == NULL ? NULL : lod_arena_calloc(scratch, (size_t)canvas.width * canvas.height, sizeof *canvas.samples);
  enum lod_status status = canvas.samples != NULL && picture->rgba != NULL ? LOD_OK : LOD_MEMORY;
  const struct lod_sphere frame = settings->frame != NULL ? *settings->frame : own_sphere(meshes, mesh_count);
  aim(&canvas, &frame);
  for (uint32_t m = 0; m < mesh_count && status == LOD_OK; m++)
    status = draw_mesh(&canvas, &meshes[m], m == 0 ? settings->heat : NULL, scratch);
  if (status == LOD_OK) {
    resolve(&canvas, picture);
    if (settings->heat != NULL)
      draw_legend(picture, settings->heat_max);
  }
  lod_arena_destroy(scratch);
  return status == LOD_OK ? LOD_OK : lod_fail_memory(problem);
}
