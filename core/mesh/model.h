/* What was uploaded: parts with their instances, materials and textures. Importers make it, families simplify its units, exporters
 * write it. Everything belongs to one arena. */
#ifndef LOD_CORE_MESH_MODEL_H
#define LOD_CORE_MESH_MODEL_H

#include "core/mesh/mesh.h"

/* An encoded picture, passed through as it came. */
struct lod_image {
  const char *name; /* "" when it has none */
  const char *mime; /* "image/png", "image/jpeg", "image/webp", "image/ktx2" */
  const uint8_t *bytes;
  size_t size;
  uint32_t width, height; /* pixels, read from the header */
};

/* A picture with the way it is sampled. */
struct lod_texture {
  uint32_t image;      /* index into images */
  uint32_t fallback;   /* index into images of the plain picture where `image` is WebP or KTX2; LOD_NONE = none */
  const char *sampler; /* glTF 2.0 sampler object as JSON text, or NULL */
};

/* A glTF 2.0 material object as JSON text, complete with extensions; texture indices in it refer to lod_model.textures. core never
 * reads it; whatever the family, it goes out as it came in. */
struct lod_material {
  const char *name;
  const char *json;
};

/* One geometry with its instances. Its triangles are in lod_model.units[unit], tagged with this part's index. */
struct lod_part {
  const char *name;
  uint32_t unit;
  uint32_t instance_count; /* at least 1 */
  double (*instances)[16]; /* column-major 4x4, as glTF: part to model space */
  bool has_normals, has_colors;
  bool has_uv[LOD_UV_SETS];
};

/* What is simplified together. All parts that occur once share unit 0: their instance transforms are already applied to the positions
 * (so their one instance is the identity) and clustering works across them. A part with several instances is a unit by itself, in its
 * own space. unit.mesh.parts is set whenever the model has more than one part. */
struct lod_unit {
  struct lod_mesh mesh;
  double scale; /* largest stretch of any of its instance transforms: an error e in the unit is at most scale * e in the model */
  const struct lod_charts *charts; /* or NULL; for families of curves */
};

/* Where the triangles of a unit lie on the spline patches that they were cut from. A chart is a triangle of a patch's domain. */
struct lod_charts {
  uint32_t count;
  double (*nets)[10][3]; /* count: a cubic near the chart's part of the patch, control points as core/clod/bezier.h numbers them */
  uint32_t *of;          /* triangle_count: chart of each triangle */
  float (*at)[3][3];     /* triangle_count: barycentric coordinates of its corners in the chart; exactly 0 on the chart's sides */
};

struct lod_model {
  const char *format; /* "gltf", "glb", "ply", "stl", "obj", "off", ... */
  const char *name;   /* for people; "" when it has none */
  uint32_t unit_count, part_count, material_count, texture_count, image_count, warning_count;
  struct lod_unit *units;
  struct lod_part *parts;
  struct lod_material *materials;
  struct lod_texture *textures;
  struct lod_image *images;
  const char **warnings;     /* sentences for the manifest */
  uint64_t source_vertices;  /* as the file counts them, before welding */
  uint64_t source_triangles; /* after triangulation of n-gons */
  /* Bound on the rounding of positions that the file holds in more than float precision or that were transformed (model units): part
   * of every level's certified error. 0 when the positions are the file's own floats. */
  double rounding;
};

/* Box and a small bounding sphere of everything, instances applied. */
struct lod_sphere {
  double center[3];
  double radius;
};
struct lod_bounds lod_model_bounds(const struct lod_model *model);
struct lod_sphere lod_model_sphere(const struct lod_model *model);

#endif
