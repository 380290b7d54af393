/* What the files of the certified collapse share. */
#ifndef LOD_CORE_ENVELOPE_INTERNAL_H
#define LOD_CORE_ENVELOPE_INTERNAL_H

#include "core/envelope/certificate.h"
#include "core/envelope/collapse.h"
#include "core/envelope/curves.h"
#include "core/envelope/surface.h"

struct lod_quadric;
struct entry;
struct witness;

struct lod_collapser {
  const struct lod_mesh *mesh;
  struct lod_arena *arena;
  uint32_t *patch; /* per source triangle: region between features; a face keeps to the patch of the triangle it began as */
  struct lod_collapse_settings settings;
  struct lod_surface surface;
  struct lod_certificate *certificate;
  struct lod_curves curves;
  double epsilon;              /* of the current stage */
  struct lod_quadric *quadric; /* per vertex */
  uint32_t *near;              /* per vertex: a source triangle near it */
  uint32_t *stamp;             /* per vertex: changes with it */
  uint32_t *face_mark, mark;
  struct entry *heap;
  size_t heap_count, heap_capacity;
  struct witness *witnesses;  /* direct-mapped by edge */
  uint32_t *kept, kept_count; /* degenerate source triangles that no face answers for */
  double least_normal_dot;
  double gate;          /* mean squared distance to the planes around, above which an edge is not tried */
  uint32_t proxy_faces; /* of the last proxy */
  double proxy_epsilon; /* proven of it */
};

#endif
