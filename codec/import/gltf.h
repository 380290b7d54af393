/* The structure of a glTF 2.0 document as plain C: what tinygltf makes of a JSON text, no C++ type, no bytes of buffers or images.
 *
 * tinygltf never sees what was uploaded. gltf_schema.c parses and checks the JSON, keeps only the members below and writes them anew;
 * buffers, images and extensions stay on our side. So nothing is read from disk, no image is decoded, and no index is out of range. */
#ifndef LOD_CODEC_IMPORT_GLTF_H
#define LOD_CODEC_IMPORT_GLTF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/arena.h"
#include "core/base/status.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { LOD_GLTF_BYTE = 5120, LOD_GLTF_UBYTE, LOD_GLTF_SHORT, LOD_GLTF_USHORT, LOD_GLTF_UINT = 5125, LOD_GLTF_FLOAT };
enum { LOD_GLTF_POINTS, LOD_GLTF_LINES, LOD_GLTF_LINE_LOOP, LOD_GLTF_LINE_STRIP, LOD_GLTF_TRIANGLES, LOD_GLTF_STRIP, LOD_GLTF_FAN };

struct lod_gltf_view {
  int32_t buffer;
  uint64_t offset, length, stride; /* stride 0 = packed */
};

struct lod_gltf_accessor {
  int32_t view; /* -1 = zeros */
  uint64_t offset, count;
  int32_t component;  /* LOD_GLTF_BYTE ... */
  int32_t components; /* 1, 2, 3, 4; 4, 9, 16 for matrices */
  bool normalized, matrix;
  uint64_t sparse_count; /* 0 = not sparse */
  int32_t sparse_index_view, sparse_index_component, sparse_value_view;
  uint64_t sparse_index_offset, sparse_value_offset;
};

enum { LOD_GLTF_SKIN_SETS = 4 };

/* Accessor numbers, -1 = none. */
struct lod_gltf_primitive {
  int32_t mode, material, indices;
  int32_t position, normal, uv[2], color, epsilon; /* epsilon: _EPSILON */
  int32_t interest;                                /* _DOI */
  int32_t joints[LOD_GLTF_SKIN_SETS], weights[LOD_GLTF_SKIN_SETS];
  bool has_tangent, has_other; /* TANGENT; TEXCOORD_2 and up, COLOR_1 and up, names of an application */
};

struct lod_gltf_mesh {
  const char *name;
  uint32_t first_primitive, primitive_count;
};

struct lod_gltf_node {
  const char *name;
  int32_t mesh, skin;
  double matrix[16];                 /* local; from translation, rotation and scale where it has no matrix */
  uint32_t first_child, child_count; /* in lod_gltf.children */
};

struct lod_gltf_skin {
  uint32_t first_joint, joint_count; /* in lod_gltf.joints */
  int32_t inverse_bind;              /* accessor or -1 */
};

struct lod_gltf_scene {
  uint32_t first_root, root_count; /* in lod_gltf.roots */
};

struct lod_gltf {
  uint32_t view_count, accessor_count, primitive_count, mesh_count, node_count, skin_count, scene_count;
  uint32_t child_count, joint_count, root_count;
  struct lod_gltf_view *views;
  struct lod_gltf_accessor *accessors;
  struct lod_gltf_primitive *primitives;
  struct lod_gltf_mesh *meshes;
  struct lod_gltf_node *nodes;
  struct lod_gltf_skin *skins;
  struct lod_gltf_scene *scenes;
  uint32_t *children, *joints, *roots;
  int32_t scene; /* -1 = none */
};

/* json: NUL-terminated, as gltf_schema.c wrote it; no_view: the bufferView number that stands for "none". message: why it failed, for
 * people. LOD_BAD_INPUT when tinygltf refuses it, LOD_MEMORY. */
enum lod_status lod_gltf_parse(const char *json, size_t size, int32_t no_view, struct lod_arena *arena, struct lod_gltf *gltf,
                               char message[200]);

#ifdef __cplusplus
}
#endif

#endif
