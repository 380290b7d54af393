/* Decoded pieces in, lod_model out: cleans attributes, applies instance transforms, joins what occurs once into unit 0, welds, tags.
 *
 * Rounding. Positions of a part that occurs once are transformed in double and rounded to float once. The bound kept in
 * lod_model.rounding is the largest of: what the reader rounded, times the transform's stretch, plus the measured distance between the
 * double and the float position, plus the error of evaluating the transform in double (none when every row of the matrix is a signed
 * power of two in one column). The world matrix itself, a product of node matrices in double, is taken as what the file says. */
#ifndef LOD_CODEC_IMPORT_SCENE_H
#define LOD_CODEC_IMPORT_SCENE_H

#include "core/base/parallel.h"
#include "core/mesh/model.h"

struct lod_scene;

/* scratch: for pieces, may be destroyed after lod_scene_finish. arena: for what the model keeps. NULL when memory is out. */
struct lod_scene *lod_scene_create(struct lod_arena *scratch, struct lod_arena *arena);

/* One geometry as a reader decoded it. */
struct lod_scene_part {
  const char *name; /* or NULL */
  /* In part space. positions, normals, uvs and colours may be changed in place. Attributes belong to wedges; see lod_scene_share_index
   * for files with one index. `parts` is ignored. Materials are numbers that lod_scene_add_material gave. */
  struct lod_mesh mesh;
  double rounding;                 /* bound on the distance of mesh.positions from what the file says */
  uint32_t instance_count;         /* at least 1 */
  double (*instances)[16];         /* column-major, finite, last row 0 0 0 1; NULL = one identity */
  const struct lod_charts *charts; /* of mesh, or NULL; dropped where the part is not alone in the model */
};

/* For meshes whose attributes have the positions' index: wedge v is vertex v. Does nothing to a mesh without attributes. */
LOD_WARN_UNUSED enum lod_status lod_scene_share_index(struct lod_mesh *mesh, struct lod_arena *arena);

/* Checks indices and coordinates ("index-out-of-range", "non-finite"), repairs attributes (unit normals, finite UVs, colours in [0, 1]) and
 * takes the part. name_of_file is for the sentence. */
LOD_WARN_UNUSED enum lod_status lod_scene_add_part(struct lod_scene *scene, const struct lod_scene_part *part, const char *name_of_file,
                                                   struct lod_problem *problem);

/* Each returns the new entry's number, LOD_NONE when memory is out. Strings are copied; image bytes are not. */
uint32_t lod_scene_add_image(struct lod_scene *scene, const struct lod_image *image);
uint32_t lod_scene_add_texture(struct lod_scene *scene, const struct lod_texture *texture);
uint32_t lod_scene_add_material(struct lod_scene *scene, const char *name, const char *json);

/* A sentence for the manifest. The same sentence is kept once; after 64 the rest is dropped. */
__attribute__((format(printf, 2, 3))) void lod_scene_warn(struct lod_scene *scene, const char *format, ...);

/* Builds the units. model->format and name are left to the caller. "empty" when there is no triangle. */
LOD_WARN_UNUSED enum lod_status lod_scene_finish(struct lod_scene *scene, uint64_t source_vertices, const char *name_of_file,
                                                 struct lod_model *model, struct lod_problem *problem);

/* 4x4 column-major helpers that importers share. */
void lod_matrix_identity(double m[16]);
void lod_matrix_multiply(const double a[16], const double b[16], double product[16]); /* product = a b; may not alias */
bool lod_matrix_is_finite(const double m[16]);
/* Upper bound on how much the 3x3 part stretches any vector. */
double lod_matrix_stretch(const double m[16]);

/* sRGB to linear, both in [0, 1]. */
float lod_linear_from_srgb(float value);

#endif
