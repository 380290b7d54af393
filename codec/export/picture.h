/* Pictures of meshes without a graphics card: for reports, for `inspect --picture`, and for people who review a level.
 *
 * A perspective three-quarter view that frames the bounding sphere; z-buffer, 2 x 2 samples a pixel, one thread, the same bytes every
 * time. Triangles are lit from both sides; free edges are drawn as capsules and free points as balls of their thickness. */
#ifndef LOD_CODEC_EXPORT_PICTURE_H
#define LOD_CODEC_EXPORT_PICTURE_H

#include "core/mesh/model.h"

enum { LOD_PICTURE_MAX_SIDE = 8192 };

struct lod_picture_settings {
  uint32_t width, height;            /* pixels, 1 to LOD_PICTURE_MAX_SIDE; default 800 x 800 */
  double yaw_degrees, pitch_degrees; /* where the eye is: around the up axis, above the horizon; default 35 and 20 */
  int up_axis;                       /* 1 = y (glTF; default), 2 = z */
  double fov_degrees;                /* vertical; default 35 */
  const struct lod_sphere *frame;    /* what to frame, to compare levels from one eye; NULL: the meshes' own sphere */
  bool flat;                         /* one normal a triangle; default: the mesh's normals, or smooth with creases at 40 degrees */
  bool wireframe;                    /* the triangles' edges over the shading */
  /* Colour by a number a vertex, with a legend from 0 to heat_max: blue, green, yellow, red. Of the first mesh; NULL: none. */
  const double *heat;
  double heat_max;
  const float (*material_colors)[4]; /* linear RGBA by material; NULL: none. Vertex colours multiply it as in glTF */
  uint32_t material_color_count;
};
struct lod_picture_settings lod_picture_defaults(void);

struct lod_picture {
  uint32_t width, height;
  uint8_t (*rgba)[4]; /* width * height, rows from the top, sRGB, opaque */
};

/* meshes: drawn together, in one space (lod_model_flatten makes one of a model). Fails with LOD_MEMORY, and with LOD_BAD_INPUT when
 * width or height is out of range. */
LOD_WARN_UNUSED enum lod_status lod_picture_render(const struct lod_mesh *meshes, uint32_t mesh_count,
                                                   const struct lod_picture_settings *settings, struct lod_arena *arena,
                                                   struct lod_picture *picture, struct lod_problem *problem);

#endif
