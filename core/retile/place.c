/* Nested points: lines first, each in one dimension, then faces; every level has the points of the coarser ones (Turk 1992, 6.1). */
#include <math.h>
#include <string.h>

#include "core/retile/internal.h"

struct placer {
  const struct sheet *sheet;
  const struct lod_retile_settings *settings;
  const uint32_t *counts;
  uint32_t level_count;
  struct lod_arena *arena, *scratch;
  /* Points of all lines, line after line, in order along each; ends of open lines are corners and not among them. */
  struct line_point {
    double at; /* way from the line's start */
    uint8_t birth;
  } * along;
  uint32_t *along_count; /* by line */
  uint32_t along_capacity;
  struct line_point **of_line;
  double spacing[LOD_RETILE_MAX_LEVELS];
  uint32_t fixed[LOD_RETILE_MAX_LEVELS], on_lines[LOD_RETILE_MAX_LEVELS], on_faces[LOD_RETILE_MAX_LEVELS];
};

static bool borders(const struct sheet *sheet, const struct sheet_line *line) {
  return sheet->twin[sheet->steps[line->begin].half_edge] == LOD_NONE;
}

static uint32_t pieces(double gap, double spacing) {
  double n = floor(gap / spacing + 0.5);
  return n < 1 ? 1 : n > 1e8 ? 100000000 : (uint32_t)n;
}

/* Points that spacing lines at `spacing` adds to line i. */
static uint32_t line_gain(const struct placer *p, uint32_t i, double spacing) {
  const struct sheet_line *line = &p->sheet->lines[i];
  const struct line_point *points = p->of_line[i];
  uint32_t count = p->along_count[i], gain = 0;
  double last = line->closed && count != 0 ? points[count - 1].at - line->length : 0;
  for (uint32_t k = 0; k < count; k++) {
    if (k > 0 || !line->closed || count != 0)
      gain += pieces(points[k].at - last, spacing) - 1;
    last = points[k].at;
  }
  if (!line->closed)
    gain += pieces(line->length - last, spacing) - 1;
  return gain;
}

static enum lod_status refine_line(struct placer *p, uint32_t i, double spacing, uint8_t birth) {
  const struct sheet_line *line = &p->sheet->lines[i];
  uint32_t gain = line_gain(p, i, spacing), count = p->along_count[i], out = 0;
  if (gain == 0)
    return LOD_OK;
  struct line_point *fresh, *old = p->of_line[i];
  RETILE_TRY_NEW(fresh, p->scratch, (size_t)count + gain);
  double last = line->closed ? old[count - 1].at - line->length : 0;
  for (uint32_t k = 0; k <= count; k++) {
    if (k == count && line->closed)
      break;
    double end = k < count ? old[k].at : line->length;
    uint32_t n = pieces(end - last, spacing);
    for (uint32_t j = 1; j < n; j++) {
      double at = last + (end - last) * j / n;
      fresh[out++] = (struct line_point){at < 0 ? at + line->length : at, birth};
    }
    if (k < count)
      fresh[out++] = old[k];
    last = end;
  }
  /* What lies before a closed line's start belongs to its end. */
  for (uint32_t k = 1; k < out; k++) {
    struct line_point x = fresh[k];
    uint32_t j = k;
    for (; j > 0 && fresh[j - 1].at > x.at; j--)
      fresh[j] = fresh[j - 1];
    fresh[j] = x;
  }
  p->of_line[i] = fresh;
  p->along_count[i] = out;
  return LOD_OK;
}

/* Lines that go around need three points to stay lines that go around; lines from a corner to itself two. */
static enum lod_status start_lines(struct placer *p, uint32_t level) {
  const struct sheet *sheet = p->sheet;
  for (uint32_t i = 0; i < sheet->line_count; i++) {
    const struct sheet_line *line = &sheet->lines[i];
    const struct sheet_step *first = &sheet->steps[line->begin], *last = &sheet->steps[line->end - 1];
    uint32_t start = sheet->faces[first->half_edge / 3][(first->half_edge + first->reversed) % 3];
    uint32_t end = sheet->faces[last->half_edge / 3][(last->half_edge + !last->reversed) % 3];
    if (line->birth != level || line->cut || (!line->closed && sheet->origin[start] != sheet->origin[end]))
      continue;
    RETILE_TRY_NEW(p->of_line[i], p->scratch, 3);
    for (uint32_t k = line->closed ? 0 : 1; k < 3; k++)
      p->of_line[i][p->along_count[i]++] = (struct line_point){line->length * k / 3, (uint8_t)level};
  }
  p->fixed[level] = 0; /* mesh vertices: copies count once */
  for (uint32_t v = 0; v < sheet->vertex_count; v++)
    p->fixed[level] += sheet->birth[v] <= level && (v == 0 || sheet->origin[v - 1] != sheet->origin[v]);
  return LOD_OK;
}

static bool has_line(const struct placer *p, uint32_t i, uint32_t level) {
  return p->sheet->lines[i].birth <= level && !p->sheet->lines[i].cut;
}

/* The spacing that gives a level its count: lines take their share first, then faces (a hexagonal lattice). */
static void face_share(const struct placer *p, uint32_t level, double spacing, double *total, uint32_t *lines) {
  double weight = 0;
  *lines = 0;
  for (uint32_t i = 0; i < p->sheet->line_count; i++) {
    if (!has_line(p, i, level))
      continue;
    uint32_t n = p->along_count[i] + line_gain(p, i, spacing);
    *lines += n;
    weight += n * (borders(p->sheet, &p->sheet->lines[i]) ? 0.5 : 1.0);
  }
  double faces = p->sheet->weighted_area / (spacing * spacing * 0.86602540378443865) - weight - 0.5 * p->fixed[level];
  *total = p->fixed[level] + *lines + fmax(0, faces);
}

static enum lod_status space_level(struct placer *p, uint32_t level) {
  double low = sqrt(p->sheet->weighted_area) * 1e-6, high = sqrt(p->sheet->weighted_area) * 4 + 1e-300;
  for (uint32_t i = 0; i < p->sheet->line_count; i++)
    high = fmax(high, 2 * p->sheet->lines[i].length);
  double total;
  uint32_t lines;
  for (int step = 0; step < 60; step++) {
    double middle = sqrt(low * high);
    face_share(p, level, middle, &total, &lines);
    if (total > p->counts[level])
      low = middle;
    else
      high = middle;
  }
  p->spacing[level] = high;
  for (uint32_t i = 0; i < p->sheet->line_count; i++)
    if (has_line(p, i, level))
      LOD_TRY(refine_line(p, i, high, (uint8_t)level));
  p->on_lines[level] = 0;
  for (uint32_t i = 0; i < p->sheet->line_count; i++)
    p->on_lines[level] += has_line(p, i, level) ? p->along_count[i] : 0;
  uint32_t taken = p->on_lines[level] + p->fixed[level], before = level > 0 ? p->on_faces[level - 1] : 0;
  p->on_faces[level] = p->counts[level] > taken + before ? p->counts[level] - taken : before;
  return LOD_OK;
}

/* Where a way along the line leads. */
static void site_on_line(const struct sheet *sheet, const struct sheet_line *line, double at, struct site *site) {
  uint32_t s = line->begin;
  double length = sheet_step_length(sheet, &sheet->steps[s]);
  while (s + 1 < line->end && at >= length) {
    at -= length;
    length = sheet_step_length(sheet, &sheet->steps[++s]);
  }
  uint32_t h = sheet->steps[s].half_edge;
  double share = length > 0 ? fmin(1, fmax(0, at / length)) : 0;
  if (sheet->steps[s].reversed)
    share = 1 - share;
  uint32_t t = (uint32_t)lrint(share * LOD_RETILE_ONE), margin = LOD_RETILE_ONE >> 12;
  site->vertex = LOD_NONE;
  if (t <= margin || t >= LOD_RETILE_ONE - margin) { /* the vertex itself, rather than a sliver */
    t = t <= margin ? 0 : LOD_RETILE_ONE;
    site->vertex = sheet->faces[h / 3][(h + (t != 0)) % 3];
  }
  site->point = (struct lod_retile_point){.face = h / 3};
  site->point.weights[h % 3] = LOD_RETILE_ONE - t;
  site->point.weights[(h + 1) % 3] = t;
}

struct cloud {
  struct cloud_point *points;
  uint8_t *birth;
  uint32_t fixed, count; /* fixed: on lines and corners */
};

static enum lod_status add_fixed(struct placer *p, struct cloud *cloud, struct sites *sites, uint32_t faces) {
  const struct sheet *sheet = p->sheet;
  uint32_t corners = 0, lines = 0;
  for (uint32_t v = 0; v < sheet->vertex_count; v++)
    corners += sheet->birth[v] != SHEET_NEVER;
  for (uint32_t i = 0; i < sheet->line_count; i++)
    lines += p->along_count[i];
  RETILE_TRY_NEW(sites->items, p->arena, (size_t)lines + faces);
  RETILE_TRY_NEW(cloud->points, p->scratch, (size_t)corners + lines + faces);
  RETILE_TRY_NEW(cloud->birth, p->scratch, (size_t)corners + lines + faces);
  bool *seen;
  RETILE_TRY_NEW_ZERO(seen, p->scratch, sheet->vertex_count);
  for (uint32_t f = 0; f < sheet->face_count; f++)
    for (uint32_t k = 0; k < 3 && sheet->faces[f][0] != LOD_NONE; k++) {
      uint32_t v = sheet->faces[f][k];
      if (sheet->birth[v] == SHEET_NEVER || seen[v])
        continue;
      struct lod_retile_point at = {f, {k == 0 ? LOD_RETILE_ONE : 0, k == 1 ? LOD_RETILE_ONE : 0, k == 2 ? LOD_RETILE_ONE : 0}};
      seen[v] = true;
      cloud_place(sheet, &at, &cloud->points[cloud->fixed]);
      cloud->birth[cloud->fixed++] = sheet->birth[v];
    }
  for (uint32_t i = 0; i < sheet->line_count; i++)
    for (uint32_t k = 0; k < p->along_count[i] && !sheet->lines[i].cut; k++) {
      struct site *site = &sites->items[sites->count++];
      site_on_line(sheet, &sheet->lines[i], p->of_line[i][k].at, site);
      site->birth = cloud->birth[cloud->fixed] = p->of_line[i][k].birth;
      cloud_place(sheet, &site->point, &cloud->points[cloud->fixed]);
      cloud->fixed++;
    }
  return LOD_OK;
}

/* Normals at a right angle are 2^(1/2) apart. */
static double bend_of(const struct placer *p, uint32_t level) {
  return p->settings->anisotropy / 1.4142135623730951 * sqrt(p->sheet->area / fmax(1, p->counts[level]));
}

/* Chooses which face points belong to which level, finest first: level k's are chosen among level k + 1's. */
static enum lod_status choose_births(struct placer *p, struct cloud *cloud) {
  uint32_t face_count = cloud->count - cloud->fixed;
  struct cloud_point *subset;
  uint32_t *from;
  bool *kept;
  RETILE_TRY_NEW(subset, p->scratch, cloud->count);
  RETILE_TRY_NEW(from, p->scratch, cloud->count);
  RETILE_TRY_NEW(kept, p->scratch, cloud->count);
  uint8_t *birth = cloud->birth + cloud->fixed;
  memset(birth, (int)p->level_count, face_count); /* of no level yet */
  for (uint32_t level = p->level_count; level-- > 0;) {
    uint32_t fixed = 0, count = 0;
    for (uint32_t i = 0; i < cloud->fixed; i++)
      if (cloud->birth[i] <= level)
        subset[fixed++] = cloud->points[i];
    count = fixed;
    for (uint32_t i = 0; i < face_count; i++)
      if (birth[i] == level + 1) {
        from[count] = i;
        subset[count++] = cloud->points[cloud->fixed + i];
      }
    uint32_t keep = p->on_faces[level];
    double distance = 2 * sqrt(p->sheet->weighted_area / (2 * 1.7320508075688772 * fmax(1, keep + 0.5 * fixed)));
    LOD_TRY(sample_eliminate(subset, fixed, count, keep, distance, bend_of(p, level), p->scratch, kept));
    for (uint32_t i = fixed; i < count; i++)
      if (kept[i])
        birth[from[i]] = (uint8_t)level;
  }
  return LOD_OK;
}

/* Moves each level's points apart, coarsest first. */
static enum lod_status relax(struct placer *p, struct cloud *cloud) {
  struct cloud_point *subset;
  uint32_t *from;
  RETILE_TRY_NEW(subset, p->scratch, cloud->count);
  RETILE_TRY_NEW(from, p->scratch, cloud->count);
  for (uint32_t level = 0; level < p->level_count; level++) {
    uint32_t fixed = 0, count = 0;
    for (uint32_t i = 0; i < cloud->count; i++)
      if (cloud->birth[i] < level || (i < cloud->fixed && cloud->birth[i] == level))
        subset[fixed++] = cloud->points[i];
    count = fixed;
    for (uint32_t i = cloud->fixed; i < cloud->count; i++)
      if (cloud->birth[i] == level) {
        from[count] = i;
        subset[count++] = cloud->points[i];
      }
    double radius =
        p->settings->radius *
        sqrt(p->sheet->weighted_area / fmax(1, p->on_faces[level] + 0.5 * (fixed < p->on_lines[level] ? fixed : p->on_lines[level])));
    LOD_TRY(repel_points(p->sheet, subset, fixed, count, radius, p->settings->damping, bend_of(p, level), p->settings->steps,
                         p->settings->threads, p->scratch));
    for (uint32_t i = fixed; i < count; i++)
      cloud->points[from[i]] = subset[i];
  }
  return LOD_OK;
}

static enum lod_status place(struct placer *p, const struct lod_progress *progress, struct sites *sites) {
  RETILE_TRY_NEW_ZERO(p->along_count, p->scratch, p->sheet->line_count);
  RETILE_TRY_NEW_ZERO(p->of_line, p->scratch, p->sheet->line_count);
  for (uint32_t level = 0; level < p->level_count; level++) {
    LOD_TRY(start_lines(p, level));
    LOD_TRY(space_level(p, level));
  }
  bool turk = p->settings->placement == LOD_RETILE_TURK;
  uint32_t most = p->sheet->area > 0 ? p->on_faces[p->level_count - 1] : 0, drawn = turk ? most : most * (most > 100000 ? 3 : 4);
  struct cloud cloud = {0};
  LOD_TRY(add_fixed(p, &cloud, sites, drawn));
  LOD_TRY(sample_draw(p->sheet, drawn, !turk, p->settings->seed, p->scratch, cloud.points + cloud.fixed));
  cloud.count = cloud.fixed + drawn;
  lod_progress_report(progress, "sample", 0.05);
  if (turk) {
    for (uint32_t i = 0, level = 0; i < drawn; i++) {
      while (i >= p->on_faces[level])
        level++;
      cloud.birth[cloud.fixed + i] = (uint8_t)level;
    }
  } else {
    LOD_TRY(choose_births(p, &cloud));
  }
  if (lod_progress_cancelled(progress))
    return LOD_CANCELLED;
  lod_progress_report(progress, "repel", 0.2);
  LOD_TRY(relax(p, &cloud));
  for (uint32_t i = cloud.fixed; i < cloud.count; i++)
    if (cloud.birth[i] < p->level_count)
      sites->items[sites->count++] = (struct site){cloud.points[i].at, LOD_NONE, cloud.birth[i]};
  return LOD_OK;
}

enum lod_status place_sites(const struct sheet *sheet, const struct lod_retile_settings *settings, const uint32_t *counts,
                            uint32_t level_count, const struct lod_progress *progress, struct lod_arena *arena, struct sites *sites) {
  *sites = (struct sites){0};
  if (sheet->face_count == 0 || level_count == 0)
    return LOD_OK;
  struct placer p = {.sheet = sheet,
                     .settings = settings,
                     .counts = counts,
                     .level_count = level_count,
                     .arena = arena,
                     .scratch = lod_arena_create_child(arena)};
  enum lod_status status = p.scratch == NULL ? LOD_MEMORY : place(&p, progress, sites);
  lod_arena_destroy(p.scratch);
  return status;
}
