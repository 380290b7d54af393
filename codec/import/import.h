/* Any model file in, one lod_model out. The format is sniffed from the content; the name's ending only breaks ties.
 *
 * glTF and GLB through tinygltf, binary PLY and STL through streaming readers of our own, patch files, and everything else through assimp.
 * Never crashes on bad bytes: a status, and a problem that names the file, what is wrong and what was expected. */
#ifndef LOD_CODEC_IMPORT_IMPORT_H
#define LOD_CODEC_IMPORT_IMPORT_H

#include "core/base/parallel.h"
#include "core/mesh/model.h"

/* Each is a setting of bake with this default and this sentence (see lod_import_limits_defaults). 0 = no limit. */
struct lod_import_limits {
  uint64_t max_bytes;          /* of the file and of everything it refers to, together */
  uint64_t max_vertices;       /* after decoding, instances not counted */
  uint64_t max_triangles;      /* after triangulation, instances not counted */
  uint32_t max_instances;      /* of all parts together */
  uint32_t max_depth;          /* of the node tree and of nested JSON */
  uint32_t max_texture_pixels; /* width or height of a texture */
  uint64_t max_texture_bytes;  /* of one encoded texture */
};
struct lod_import_limits lod_import_limits_defaults(void);

/* Where files that the model refers to come from (glTF buffers and images, OBJ materials). */
struct lod_import_files {
  /* uri: relative, percent-decoded, already checked: no scheme, not absolute, no "..". Fills bytes (valid until the import ends) or
   * returns a status with the problem filled. */
  enum lod_status (*read)(void *context, const char *uri, struct lod_arena *arena, const uint8_t **bytes, size_t *size,
                          struct lod_problem *problem);
  void *context; /* not owned */
};

/* Files beneath an open directory, never outside it (openat2 RESOLVE_BENEATH | RESOLVE_NO_SYMLINKS, or a checked walk where the kernel
 * lacks it). */
struct lod_import_files lod_import_files_beneath(int *directory_fd);

struct lod_import_request {
  const char *name;   /* file name for messages and tie-breaking, never opened */
  const char *format; /* forced: "glb", "ply", ...; NULL = sniff */
  const uint8_t *bytes;
  size_t size;
  const struct lod_import_files *files;   /* NULL: the model must be self-contained */
  const struct lod_import_limits *limits; /* NULL: defaults */
  const struct lod_progress *progress;    /* may be NULL */
  uint32_t threads;
};

/* On LOD_OK `model` is complete: units welded, parts tagged, warnings filled; it has at least one triangle. Everything in `arena`;
 * model->images may point into request->bytes. */
LOD_WARN_UNUSED enum lod_status lod_import_model(const struct lod_import_request *request, struct lod_arena *arena, struct lod_model *model,
                                                 struct lod_problem *problem);

/* Format by content: "glb", "gltf", "ply", "stl", "obj", ...; NULL when unknown. */
const char *lod_import_sniff(const uint8_t *bytes, size_t size, const char *name);

#endif
