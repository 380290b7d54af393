/* A glTF document under import: its checked JSON, its structure, and its bytes behind bounds checks. */
#ifndef LOD_CODEC_IMPORT_GLTF_DOCUMENT_H
#define LOD_CODEC_IMPORT_GLTF_DOCUMENT_H

#include <jansson.h>

#include "codec/import/gltf.h"
#include "codec/import/reader.h"

struct lod_gltf_bytes {
  const uint8_t *bytes;
  size_t size;
  bool loaded;
};

struct lod_gltf_document {
  struct lod_reader *reader;
  json_t *root;          /* owned: lod_gltf_document_finish */
  const uint8_t *binary; /* BIN chunk, or NULL */
  size_t binary_size;
  struct lod_gltf gltf;
  uint32_t buffer_count;
  struct lod_gltf_bytes *buffers; /* buffer_count */
  struct lod_gltf_bytes *views;   /* gltf.view_count; decompressed where needed */
};

/* --- gltf_schema.c --- */

/* Container, JSON, types, index ranges, extensions that are required, URIs. On failure too call _finish. */
LOD_WARN_UNUSED enum lod_status lod_gltf_document_init(struct lod_gltf_document *document, struct lod_reader *reader);
void lod_gltf_document_finish(struct lod_gltf_document *document);

/* The object root[collection][index], NULL when there is none. */
json_t *lod_gltf_object(const struct lod_gltf_document *document, const char *collection, uint32_t index);

/* object.extensions[name] when it is an object, else NULL. */
json_t *lod_gltf_extension(const json_t *object, const char *name);

/* object[key] as an index below `count`; -1 when it is missing, LOD_BAD_INPUT with a problem when it is anything else. */
LOD_WARN_UNUSED enum lod_status lod_gltf_index(struct lod_gltf_document *document, const json_t *object, const char *what, const char *key,
                                               uint32_t count, int32_t *index);

/* --- gltf_accessor.c --- */

LOD_WARN_UNUSED enum lod_status lod_gltf_view_bytes(struct lod_gltf_document *document, uint32_t view, const uint8_t **bytes, size_t *size);

/* That the bytes of an accessor exist ("truncated"); before its count is held against a limit, so that the better sentence wins. */
LOD_WARN_UNUSED enum lod_status lod_gltf_check_fits(struct lod_gltf_document *document, uint32_t accessor);

/* Values as floats, `components` each, scaled by glTF's rule where normalised (or where `as_normalized` says so whatever the accessor
 * says). The accessor must have `components` per element. *values in reader->scratch; the caller has counted accessor.count against a
 * limit. */
LOD_WARN_UNUSED enum lod_status lod_gltf_read_floats(struct lod_gltf_document *document, uint32_t accessor, int components,
                                                     bool as_normalized, float **values);

/* Unsigned integers of 8, 16 or 32 bits, one component each (indices) or four (joints). */
LOD_WARN_UNUSED enum lod_status lod_gltf_read_integers(struct lod_gltf_document *document, uint32_t accessor, int components,
                                                       uint32_t **values);

/* --- gltf_material.c --- */

/* Material number in the file -> material in the scene, added with its textures and images at the first call. */
struct lod_gltf_materials;
LOD_WARN_UNUSED enum lod_status lod_gltf_materials_create(struct lod_gltf_document *document, struct lod_gltf_materials **materials);
LOD_WARN_UNUSED enum lod_status lod_gltf_material(struct lod_gltf_document *document, struct lod_gltf_materials *materials, int32_t number,
                                                  uint32_t *material);

/* --- gltf_mesh.c --- */

enum { LOD_GLTF_GROUPS = 32 }; /* sets of attributes: normal, uv 0, uv 1, colour, epsilon */

/* A mesh of the file as one lod_mesh for each set of attributes that its primitives have. */
struct lod_gltf_pieces {
  uint32_t count;
  struct lod_mesh meshes[LOD_GLTF_GROUPS];
  double rounding[LOD_GLTF_GROUPS];
};

/* joints: joint_count matrices that are blended by the vertices' weights, or NULL for a mesh that is not skinned. */
LOD_WARN_UNUSED enum lod_status lod_gltf_read_mesh(struct lod_gltf_document *document, struct lod_gltf_materials *materials, uint32_t mesh,
                                                   const double (*joints)[16], uint32_t joint_count, struct lod_gltf_pieces *pieces);

#endif
