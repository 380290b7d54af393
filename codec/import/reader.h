/* What lod_import_model hands to the reader of one format: the bytes, the limits, where to put what was read, where to complain.
 *
 * A reader is a function `enum lod_status lod_import_x(struct lod_reader *reader)`: it adds parts, materials and warnings to
 * reader->scene and returns. It frees nothing (both arenas do) and never writes past what it checked. Readers do not know one another. */
#ifndef LOD_CODEC_IMPORT_READER_H
#define LOD_CODEC_IMPORT_READER_H

#include "codec/import/import.h"
#include "codec/import/scene.h"

struct lod_reader {
  const char *name;   /* of the file, for sentences; never NULL */
  const char *format; /* as sniffed or forced */
  const uint8_t *bytes;
  size_t size;
  const struct lod_import_files *files; /* or NULL */
  struct lod_import_limits limits;      /* 0 has become the largest value */
  const struct lod_progress *progress;
  uint32_t threads;
  struct lod_arena *scratch; /* lives until the import ends */
  struct lod_arena *arena;   /* the caller's: for what the model keeps */
  struct lod_scene *scene;
  struct lod_problem *problem;

  /* Counted against the limits so far. */
  uint64_t bytes_read, vertices, triangles, instances;
  uint64_t source_vertices; /* as the file counts them, where that is not `vertices`; 0 = it is */
};

enum lod_status lod_import_gltf(struct lod_reader *reader);
enum lod_status lod_import_ply(struct lod_reader *reader);
enum lod_status lod_import_stl(struct lod_reader *reader);
enum lod_status lod_import_hoppe(struct lod_reader *reader);
enum lod_status lod_import_draco(struct lod_reader *reader);
enum lod_status lod_import_obj(struct lod_reader *reader);
enum lod_status lod_import_off(struct lod_reader *reader);
enum lod_status lod_import_assimp(struct lod_reader *reader);
enum lod_status lod_import_patches(struct lod_reader *reader);
enum lod_status lod_import_rib(struct lod_reader *reader);

/* lod_fail with "NAME: " in front of the sentence. */
__attribute__((format(printf, 4, 5))) enum lod_status lod_reader_fail(struct lod_reader *reader, enum lod_status status, const char *type,
                                                                      const char *format, ...);
#define lod_reader_bad(reader, type, ...) lod_reader_fail(reader, LOD_BAD_INPUT, type, __VA_ARGS__)
enum lod_status lod_reader_memory(struct lod_reader *reader);

/* Before allocating: count `more` against max_vertices, max_triangles, max_instances, max_bytes. */
LOD_WARN_UNUSED enum lod_status lod_reader_add_vertices(struct lod_reader *reader, uint64_t more);
LOD_WARN_UNUSED enum lod_status lod_reader_add_triangles(struct lod_reader *reader, uint64_t more);
LOD_WARN_UNUSED enum lod_status lod_reader_add_instances(struct lod_reader *reader, uint64_t more);
LOD_WARN_UNUSED enum lod_status lod_reader_add_bytes(struct lod_reader *reader, uint64_t more);

/* LOD_CANCELLED when the caller asked to stop. */
LOD_WARN_UNUSED enum lod_status lod_reader_progress(struct lod_reader *reader, double fraction);

/* The bytes (in `arena`) behind a URI as it stands in the file (percent-encoded): a data URI (base64 or percent-encoded text), or a file
 * through reader->files. Anything else is refused as "unsafe-uri": other schemes, absolute paths, "..", backslashes, control characters. */
LOD_WARN_UNUSED enum lod_status lod_reader_open_uri(struct lod_reader *reader, const char *uri, struct lod_arena *arena,
                                                    const uint8_t **bytes, size_t *size);

/* "unsafe-uri" without opening anything; data URIs are safe. */
LOD_WARN_UNUSED enum lod_status lod_reader_check_uri(struct lod_reader *reader, const char *uri);

/* The same for a path that is not percent-encoded (OBJ, FBX); backslashes are taken for slashes, "./" is dropped. */
LOD_WARN_UNUSED enum lod_status lod_reader_open_path(struct lod_reader *reader, const char *path, struct lod_arena *arena,
                                                     const uint8_t **bytes, size_t *size);

/* Either of the two for a file that the model can do without (textures, OBJ materials): when it is missing, a warning, LOD_OK and *bytes
 * NULL. Unsafe names and limits stay errors. */
LOD_WARN_UNUSED enum lod_status lod_reader_open_optional(struct lod_reader *reader, const char *name, bool is_uri, struct lod_arena *arena,
                                                         const uint8_t **bytes, size_t *size);

/* A file beside the model for formats (OBJ, FBX, ...) that name files with absolute paths of the machine they were made on: a name that is
 * not safe is cut to its last part and looked for beside the model. A missing file is a warning and *bytes NULL. */
LOD_WARN_UNUSED enum lod_status lod_reader_open_companion(struct lod_reader *reader, const char *path, struct lod_arena *arena,
                                                          const uint8_t **bytes, size_t *size);

/* Adds the encoded picture to the scene after checking its header against the limits. A picture that is no PNG, JPEG, WebP or KTX2 gives
 * a warning and LOD_NONE. name may be NULL; bytes must outlive the model or lie in reader->arena. */
LOD_WARN_UNUSED enum lod_status lod_reader_add_image(struct lod_reader *reader, const char *name, const uint8_t *bytes, size_t size,
                                                     uint32_t *image);

#endif
