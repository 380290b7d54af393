/* Attributes that go along with a changing surface: a wedge for each vertex and each of the sectors that features cut its faces into.
 *
 * Based on: Hoppe. New Quadric Metric for Simplifying Meshes with Appearance Attributes. 1999 (attributes linear over a triangle; where a
 * vertex goes, the values that fit best there are linear in its place, summed like a quadric). Ours: within bounds the values are only
 * proposed here; the certificate (backward.h) proves them against the source. */
#ifndef LOD_CORE_ENVELOPE_WEDGES_H
#define LOD_CORE_ENVELOPE_WEDGES_H

#include "core/envelope/quadric.h"
#include "core/envelope/surface.h"

enum { LOD_MOST_PLACED = 24 };
enum { LOD_MOST_CHANNELS = 2 * LOD_UV_SETS + 3 + 4, LOD_MOST_GROUPS = LOD_UV_SETS + 2 };

/* How far attributes may be from the source's at a point within epsilon that stands for it; 0 or INFINITY = no bound. */
struct lod_attribute_bounds {
  double uv;   /* distance in units of UV, in each set */
  double slip; /* the same in multiples of epsilon, by the mean size of UV on the surface: a texture is no more off than the shape;
                * the lesser of both holds */
  double normal_degrees; /* between normals as they are interpolated */
  double color;          /* distance in linear RGBA */
};

/* Channels that are bounded together. */
struct lod_channel_group {
  uint32_t first, count;
  double bound; /* on the Euclidean distance; INFINITY = none */
};

/* A channel, linear in space, times area: sums of the triangles around. */
struct lod_linear {
  struct lod_vec3 gradient;
  double offset;
};

struct lod_wedges {
  const struct lod_mesh *source; /* not owned */
  uint32_t channels;             /* 0: the source has no attributes, and nothing below is there */
  uint32_t group_count;
  struct lod_channel_group groups[LOD_MOST_GROUPS];
  int normals;  /* the group of the normals, -1 = none */
  bool bounded; /* some group is, in every stage */
  struct lod_attribute_bounds bounds;
  double density[LOD_UV_SETS];      /* units of UV in a unit of length, in the mean */
  double weight[LOD_MOST_CHANNELS]; /* 1 / bound^2; 0 = none */
  double *of_source;                /* per wedge of the source: its channels */
  uint32_t (*corner)[3];            /* per face: wedges here */
  uint32_t *initial;                /* per wedge here: a wedge of the source that it began as */
  double *value;                    /* per wedge here: its channels */
  struct lod_quadric *energy;       /* per wedge here and group: of its channels, times area, were they 0; its weight is the area */
  struct lod_linear *linear;        /* per wedge here and channel */
  uint32_t count;
};

/* What a change makes of wedges. Values placed differ from what the wedges hold. */
struct lod_placed_wedge {
  uint32_t wedge, from; /* `from` becomes part of it, LOD_NONE = nothing does */
  bool moved;           /* value replaces what it holds */
  double value[LOD_MOST_CHANNELS];
};

/* From a surface that has not changed yet. Vertices around which attributes of one sector differ by more than the bounds become corners,
 * and keep all their wedges. */
LOD_WARN_UNUSED enum lod_status lod_wedges_create(const struct lod_mesh *source, struct lod_surface *surface,
                                                  const struct lod_attribute_bounds *bounds, struct lod_arena *arena,
                                                  struct lod_wedges *wedges);

/* Of the stage to come; epsilon must not shrink. */
void lod_wedges_set_epsilon(struct lod_wedges *wedges, double epsilon);

struct lod_candidate;
struct lod_change;

/* For the collapse of (a, b) to `to` (a LOD_NONE: b moves): the wedges of the change's fresh faces, whose `face` and `vertex` are known,
 * and change->placed. False when the surface does not say which of b's wedges goes on. faces: the array behind change->faces. */
bool lod_wedges_place(const struct lod_wedges *wedges, const struct lod_surface *surface, uint32_t a, uint32_t b, struct lod_vec3 to,
                      struct lod_change *change, struct lod_candidate *faces);

/* Makes a change so. */
void lod_wedges_commit(struct lod_wedges *wedges, const struct lod_change *change);

/* What attributes lose, as an energy in units of their bounds squared times area, when (a, b) collapses to `to`; 0 without bounds. */
double lod_wedges_cost(const struct lod_wedges *wedges, const struct lod_surface *surface, uint32_t a, uint32_t b, struct lod_vec3 to);

/* Adds `scale` times what lod_wedges_cost is, as a quadric in `to`. */
void lod_wedges_add_quadric(const struct lod_wedges *wedges, const struct lod_surface *surface, uint32_t a, uint32_t b, double scale,
                            struct lod_quadric *quadric);

/* Distance of values in a group, and whether it is within the bound everywhere. */
static inline double lod_group_distance_squared(const struct lod_channel_group *group, const double *x, const double *y) {
  double sum = 0;
  for (uint32_t i = group->first; i < group->first + group->count; i++)
    sum += (x[i] - y[i]) * (x[i] - y[i]);
  return sum;
}

#endif
