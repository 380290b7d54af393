/* Small whole models, for tests of what goes from lod_model to bytes. Units are their own finest level. */
#ifndef LOD_TESTS_DATA_MODELS_H
#define LOD_TESTS_DATA_MODELS_H

#include "core/mesh/model.h"

/* A model of one part without attributes around a mesh (not copied). */
struct lod_model lod_sample_plain(struct lod_arena *arena, const char *name, struct lod_mesh mesh);

/* A closed sphere with its smooth normals. */
struct lod_model lod_sample_smooth(struct lod_arena *arena);

/* A bumpy square in two materials, left and right, with a UV seam between them, two textures that share one image (the second a WebP with a
 * PNG to fall back on) and samplers; material 1 of 3 is used by nothing. */
struct lod_model lod_sample_textured(struct lod_arena *arena);

/* A cube with a colour a face: every vertex has three wedges. Half transparent when alpha. */
struct lod_model lod_sample_colored(struct lod_arena *arena, bool alpha);

/* Two parts that share vertices in unit 0, and a third with three instances in unit 1: moved, mirrored, and sheared. */
struct lod_model lod_sample_assembly(struct lod_arena *arena);

/* A trunk of triangles with branches as thick edges and twigs as points. */
struct lod_model lod_sample_branches(struct lod_arena *arena);

/* All of the above, by number; NULL name past the end. */
struct lod_model lod_sample_model(struct lod_arena *arena, int number);
enum { LOD_SAMPLE_MODELS = 8 };

/* The units' meshes as lod_glb_write wants them. */
struct lod_mesh *lod_sample_meshes(struct lod_arena *arena, const struct lod_model *model);

#endif
