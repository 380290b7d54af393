/* What can be shown of a surface besides its shading: bending, distance from the source, points, the mutual tessellation, fragments. Each
 * makes meshes and settings for lod_picture_render. */
#ifndef LOD_CODEC_EXPORT_PICTURE_SCENE_H
#define LOD_CODEC_EXPORT_PICTURE_SCENE_H

#include "codec/export/picture.h"

enum lod_picture_kind {
  LOD_PICTURE_SHADED,
  LOD_PICTURE_WIREFRAME,    /* the triangles' edges over the shading */
  LOD_PICTURE_CURVATURE,    /* largest principal curvature, red high, blue flat (Turk 1992, Fig. 10); the scale ends at the 95 % quantile */
  LOD_PICTURE_ERROR,        /* distance of each vertex from `source`, and the largest of them as the scale's end: a sample, no bound */
  LOD_PICTURE_POINTS,       /* vertices as balls on the surface */
  LOD_PICTURE_TESSELLATION, /* the mutual tessellation: `vertices` points of re-tiling, put into the mesh's own triangles */
  LOD_PICTURE_FRAGMENTS,    /* of this level and `source`, the finer one: a colour for each coarse triangle, at t */
  LOD_PICTURE_KINDS,
};

/* "shaded", "wireframe", ...: by kind; NULL past the end. */
const char *lod_picture_kind_name(uint32_t kind);

struct lod_picture_scene {
  enum lod_picture_kind kind;
  const struct lod_mesh *mesh;   /* welded */
  const struct lod_mesh *source; /* of LOD_PICTURE_ERROR, LOD_PICTURE_FRAGMENTS; welded */
  double reach;                  /* of LOD_PICTURE_FRAGMENTS: as lod_overlay_match; 0 = a thousandth of the diagonal */
  double t;                      /* of LOD_PICTURE_FRAGMENTS: 0 = on `mesh`, 1 = on `source` */
  uint32_t vertices;             /* of LOD_PICTURE_TESSELLATION; at least 4 */
};

/* Draws the scene. settings: the picture's, whose heat, wireframe and material colours the scene sets. Fails with LOD_MEMORY, and with
 * LOD_BAD_INPUT where `source` is needed and missing, or has no part in `mesh`. */
LOD_WARN_UNUSED enum lod_status lod_picture_render_scene(const struct lod_picture_scene *scene, struct lod_picture_settings settings,
                                                         struct lod_arena *arena, struct lod_picture *picture, struct lod_problem *problem);

#endif
