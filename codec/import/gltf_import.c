/* glTF 2.0: which meshes stand where, and handing them to the scene.
 *
 * Based on: Khronos. glTF 2.0 Specification, 3.5 (scenes and nodes), 3.7.3 (skins); EXT_mesh_gpu_instancing. A mesh under several nodes is
 * one part with several instances. A skinned mesh stands where its joints put it, whatever its node says, and is baked there. */
#include <string.h>

#include "codec/import/gltf_document.h"

struct import {
  struct lod_gltf_document *document;
  struct lod_gltf_materials *materials;
  uint32_t *parents;      /* node_count; LOD_NONE = root */
  double (*worlds)[16];   /* node_count */
  bool *in_scene;         /* node_count */
  uint32_t *instances_of; /* mesh_count: placements without a skin */
};

static enum lod_status fail_cycle(struct import *import, uint32_t node) {
  return lod_reader_bad(import->document->reader, "node-cycle", "nodes[%u] is its own ancestor, or the child of two nodes", node);
}

/* --- the node tree --- */

static enum lod_status find_parents(struct import *import) {
  const struct lod_gltf *gltf = &import->document->gltf;
  memset(import->parents, 0xFF, gltf->node_count * sizeof *import->parents);
  for (uint32_t n = 0; n < gltf->node_count; n++)
    for (uint32_t i = 0; i < gltf->nodes[n].child_count; i++) {
      uint32_t child = gltf->children[gltf->nodes[n].first_child + i];
      if (child == n || import->parents[child] != LOD_NONE)
        return fail_cycle(import, child);
      import->parents[child] = n;
    }
  return LOD_OK;
}

/* World matrices from the roots down. Every node has one parent, so nodes that are not reached lie on cycles. */
static enum lod_status find_worlds(struct import *import) {
  const struct lod_gltf *gltf = &import->document->gltf;
  struct lod_reader *reader = import->document->reader;
  uint32_t *queue = LOD_NEW(reader->scratch, gltf->node_count, uint32_t),
           *depth = LOD_NEW_ZERO(reader->scratch, gltf->node_count, uint32_t);
  uint32_t count = 0;
  if (!queue || !depth)
    return lod_reader_memory(reader);
  for (uint32_t n = 0; n < gltf->node_count; n++)
    if (import->parents[n] == LOD_NONE) {
      depth[n] = 1;
      memcpy(import->worlds[n], gltf->nodes[n].matrix, sizeof import->worlds[n]);
      queue[count++] = n;
    }
  for (uint32_t i = 0; i < count; i++) {
    const struct lod_gltf_node *node = &gltf->nodes[queue[i]];
    if (depth[queue[i]] > reader->limits.max_depth)
      return lod_reader_fail(reader, LOD_LIMIT, "limit-depth", "the node tree is deeper than %u", reader->limits.max_depth);
    for (uint32_t c = 0; c < node->child_count; c++) {
      uint32_t child = gltf->children[node->first_child + c];
      lod_matrix_multiply(import->worlds[queue[i]], gltf->nodes[child].matrix, import->worlds[child]);
      depth[child] = depth[queue[i]] + 1;
      queue[count++] = child;
    }
  }
  for (uint32_t n = 0; n < gltf->node_count; n++)
    if (depth[n] == 0)
      return fail_cycle(import, n);
  return LOD_OK;
}

static enum lod_status mark_below(struct import *import, uint32_t root, uint32_t *stack) {
  const struct lod_gltf *gltf = &import->document->gltf;
  uint32_t count = 0;
  stack[count++] = root;
  while (count > 0) {
    uint32_t n = stack[--count];
    if (import->in_scene[n])
      return fail_cycle(import, n);
    import->in_scene[n] = true;
    /* Each node is pushed at most once: by its only parent, or as a root. */
    for (uint32_t i = 0; i < gltf->nodes[n].child_count; i++)
      stack[count++] = gltf->children[gltf->nodes[n].first_child + i];
  }
  return LOD_OK;
}

static enum lod_status mark_scene(struct import *import) {
  const struct lod_gltf *gltf = &import->document->gltf;
  struct lod_reader *reader = import->document->reader;
  uint32_t *stack = LOD_NEW(reader->scratch, (size_t)gltf->node_count + 1, uint32_t);
  if (!stack)
    return lod_reader_memory(reader);
  if (gltf->scene_count == 0) {
    for (uint32_t n = 0; n < gltf->node_count; n++)
      if (import->parents[n] == LOD_NONE)
        LOD_TRY(mark_below(import, n, stack));
    return LOD_OK;
  }
  uint32_t number = gltf->scene >= 0 ? (uint32_t)gltf->scene : 0;
  if (gltf->scene_count > 1)
    lod_scene_warn(reader->scene, "The file has %u scenes; only scene %u was imported.", gltf->scene_count, number);
  const struct lod_gltf_scene *scene = &gltf->scenes[number];
  for (uint32_t i = 0; i < scene->root_count; i++)
    LOD_TRY(mark_below(import, gltf->roots[scene->first_root + i], stack));
  return LOD_OK;
}

/* --- instances --- */

static const json_t *instancing_of(const struct import *import, uint32_t node) {
  return lod_gltf_extension(lod_gltf_object(import->document, "nodes", node), "EXT_mesh_gpu_instancing");
}

/* Accessors of EXT_mesh_gpu_instancing; all have `count` elements. */
struct instancing {
  uint64_t count;
  int32_t translation, rotation, scale;
};

static enum lod_status read_instancing(struct import *import, uint32_t node, struct instancing *out) {
  struct lod_gltf_document *document = import->document;
  const json_t *extension = instancing_of(import, node), *attributes = json_object_get(extension, "attributes");
  *out = (struct instancing){.count = 1, .translation = -1, .rotation = -1, .scale = -1};
  if (!extension)
    return LOD_OK;
  uint32_t count = document->gltf.accessor_count;
  LOD_TRY(lod_gltf_index(document, attributes, "EXT_mesh_gpu_instancing", "TRANSLATION", count, &out->translation));
  LOD_TRY(lod_gltf_index(document, attributes, "EXT_mesh_gpu_instancing", "ROTATION", count, &out->rotation));
  LOD_TRY(lod_gltf_index(document, attributes, "EXT_mesh_gpu_instancing", "SCALE", count, &out->scale));
  const int32_t used[3] = {out->translation, out->rotation, out->scale};
  bool first = true;
  for (int i = 0; i < 3; i++) {
    if (used[i] < 0)
      continue;
    uint64_t elements = document->gltf.accessors[used[i]].count;
    if (!first && elements != out->count)
      return lod_reader_bad(document->reader, "bad-accessor", "nodes[%u] has EXT_mesh_gpu_instancing with different counts", node);
    out->count = elements;
    first = false;
  }
  return LOD_OK;
}

static void compose(const float *t, const float *q, const float *s, double m[16]) {
  double r[4] = {0, 0, 0, 1}, length = 0;
  for (int i = 0; q && i < 4; i++)
    length += (double)q[i] * (double)q[i];
  for (int i = 0; length > 0 && i < 4; i++)
    r[i] = (double)q[i] / sqrt(length);
  double x = r[0], y = r[1], z = r[2], w = r[3];
  const double rotation[9] = {1 - 2 * (y * y + z * z), 2 * (x * y + z * w),     2 * (x * z - y * w),
                              2 * (x * y - z * w),     1 - 2 * (x * x + z * z), 2 * (y * z + x * w),
                              2 * (x * z + y * w),     2 * (y * z - x * w),     1 - 2 * (x * x + y * y)};
  lod_matrix_identity(m);
  for (int column = 0; column < 3; column++) {
    for (int row = 0; row < 3; row++)
      m[column * 4 + row] = rotation[column * 3 + row] * (s ? (double)s[column] : 1);
    m[12 + column] = t ? (double)t[column] : 0;
  }
}

/* The instances of one node behind *count. */
static enum lod_status add_instances(struct import *import, uint32_t node, double (*instances)[16], uint32_t *count) {
  struct instancing how;
  float *t = NULL, *q = NULL, *s = NULL;
  LOD_TRY(read_instancing(import, node, &how));
  if (!instancing_of(import, node)) {
    memcpy(instances[(*count)++], import->worlds[node], sizeof *instances);
    return LOD_OK;
  }
  if (how.translation >= 0)
    LOD_TRY(lod_gltf_read_floats(import->document, (uint32_t)how.translation, 3, false, &t));
  if (how.rotation >= 0)
    LOD_TRY(lod_gltf_read_floats(import->document, (uint32_t)how.rotation, 4, true, &q));
  if (how.scale >= 0)
    LOD_TRY(lod_gltf_read_floats(import->document, (uint32_t)how.scale, 3, false, &s));
  for (uint64_t i = 0; i < how.count; i++) {
    double local[16];
    compose(t ? t + 3 * i : NULL, q ? q + 4 * i : NULL, s ? s + 3 * i : NULL, local);
    lod_matrix_multiply(import->worlds[node], local, instances[(*count)++]);
  }
  return LOD_OK;
}

static bool is_skinned(const struct import *import, uint32_t node) {
  const struct lod_gltf_node *n = &import->document->gltf.nodes[node];
  return n->skin >= 0;
}

static bool is_placed(const struct import *import, uint32_t node) {
  return import->in_scene[node] && import->document->gltf.nodes[node].mesh >= 0;
}

static enum lod_status count_instances(struct import *import) {
  const struct lod_gltf *gltf = &import->document->gltf;
  for (uint32_t n = 0; n < gltf->node_count; n++) {
    struct instancing how;
    if (!is_placed(import, n))
      continue;
    LOD_TRY(read_instancing(import, n, &how));
    LOD_TRY(lod_reader_add_instances(import->document->reader, how.count));
    if (!is_skinned(import, n))
      import->instances_of[gltf->nodes[n].mesh] += (uint32_t)how.count;
  }
  return LOD_OK;
}

/* --- parts --- */

static enum lod_status add_pieces(struct import *import, const char *name, const struct lod_gltf_pieces *pieces, double (*instances)[16],
                                  uint32_t count) {
  struct lod_reader *reader = import->document->reader;
  for (uint32_t i = 0; i < pieces->count; i++) {
    struct lod_scene_part part = {
        .name = name, .mesh = pieces->meshes[i], .rounding = pieces->rounding[i], .instance_count = count, .instances = instances};
    LOD_TRY(lod_scene_add_part(reader->scene, &part, reader->name, reader->problem));
  }
  return LOD_OK;
}

/* nodes: where the mesh stands. */
static enum lod_status add_mesh(struct import *import, uint32_t mesh, const uint32_t *nodes, uint32_t node_count) {
  struct lod_reader *reader = import->document->reader;
  const struct lod_gltf *gltf = &import->document->gltf;
  double(*instances)[16] = lod_arena_alloc(reader->scratch, import->instances_of[mesh], sizeof *instances);
  struct lod_gltf_pieces *pieces = LOD_NEW(reader->scratch, 1, struct lod_gltf_pieces);
  uint32_t count = 0;
  if (!instances || !pieces)
    return lod_reader_memory(reader);
  for (uint32_t i = 0; i < node_count; i++)
    LOD_TRY(add_instances(import, nodes[i], instances, &count));
  LOD_TRY(lod_gltf_read_mesh(import->document, import->materials, mesh, NULL, 0, pieces));
  const char *name = gltf->meshes[mesh].name;
  if (!name[0] && node_count > 0)
    name = gltf->nodes[nodes[0]].name;
  return add_pieces(import, name, pieces, instances, count);
}

/* Placed nodes sorted by mesh (counting sort), then a mesh at a time. */
static enum lod_status add_meshes(struct import *import) {
  const struct lod_gltf *gltf = &import->document->gltf;
  struct lod_reader *reader = import->document->reader;
  uint32_t *first = LOD_NEW_ZERO(reader->scratch, (size_t)gltf->mesh_count + 2, uint32_t);
  uint32_t *nodes = LOD_NEW(reader->scratch, gltf->node_count, uint32_t);
  if (!first || !nodes)
    return lod_reader_memory(reader);
  for (uint32_t n = 0; n < gltf->node_count; n++)
    if (is_placed(import, n) && !is_skinned(import, n))
      first[gltf->nodes[n].mesh + 2]++;
  for (uint32_t m = 0; m < gltf->mesh_count; m++)
    first[m + 2] += first[m + 1];
  for (uint32_t n = 0; n < gltf->node_count; n++)
    if (is_placed(import, n) && !is_skinned(import, n))
      nodes[first[gltf->nodes[n].mesh + 1]++] = n;
  for (uint32_t m = 0; m < gltf->mesh_count; m++) {
    if (import->instances_of[m] > 0)
      LOD_TRY(add_mesh(import, m, nodes + first[m], first[m + 1] - first[m]));
    LOD_TRY(lod_reader_progress(reader, 0.4 * (m + 1) / gltf->mesh_count));
  }
  return LOD_OK;
}

static enum lod_status joint_matrices(struct import *import, const struct lod_gltf_skin *skin, double (**out)[16]) {
  struct lod_gltf_document *document = import->document;
  struct lod_reader *reader = document->reader;
  float *inverse = NULL;
  if (skin->inverse_bind >= 0) {
    if (document->gltf.accessors[skin->inverse_bind].count < skin->joint_count)
      return lod_reader_bad(reader, "bad-accessor", "a skin has fewer inverse bind matrices than joints");
    LOD_TRY(lod_gltf_read_floats(document, (uint32_t)skin->inverse_bind, 16, false, &inverse));
  }
  double(*matrices)[16] = lod_arena_alloc(reader->scratch, skin->joint_count, sizeof *matrices);
  if (!matrices)
    return lod_reader_memory(reader);
  for (uint32_t j = 0; j < skin->joint_count; j++) {
    const double *world = import->worlds[document->gltf.joints[skin->first_joint + j]];
    double bind[16];
    lod_matrix_identity(bind);
    for (int k = 0; inverse && k < 16; k++)
      bind[k] = (double)inverse[16 * (size_t)j + (size_t)k];
    lod_matrix_multiply(world, bind, matrices[j]);
    if (!lod_matrix_is_finite(matrices[j]))
      return lod_reader_bad(reader, "non-finite", "a joint's matrix is not finite");
  }
  *out = matrices;
  return LOD_OK;
}

static enum lod_status add_skinned(struct import *import, uint32_t node) {
  struct lod_reader *reader = import->document->reader;
  const struct lod_gltf *gltf = &import->document->gltf;
  const struct lod_gltf_node *from = &gltf->nodes[node];
  const struct lod_gltf_skin *skin = &gltf->skins[from->skin];
  double(*joints)[16] = NULL;
  struct lod_gltf_pieces *pieces = LOD_NEW(reader->scratch, 1, struct lod_gltf_pieces);
  if (!pieces)
    return lod_reader_memory(reader);
  LOD_TRY(joint_matrices(import, skin, &joints));
  LOD_TRY(lod_gltf_read_mesh(import->document, import->materials, (uint32_t)from->mesh, (const double(*)[16])joints, skin->joint_count,
                             pieces));
  lod_scene_warn(reader->scene, "Skins were applied once; the model is in its rest pose.");
  const char *name = gltf->meshes[from->mesh].name;
  return add_pieces(import, name[0] ? name : from->name, pieces, NULL, 0);
}

/* A file with meshes and no node at all: each stands at the origin. */
static enum lod_status add_loose_meshes(struct import *import) {
  struct lod_reader *reader = import->document->reader;
  const struct lod_gltf *gltf = &import->document->gltf;
  struct lod_gltf_pieces *pieces = LOD_NEW(reader->scratch, 1, struct lod_gltf_pieces);
  if (!pieces)
    return lod_reader_memory(reader);
  if (gltf->mesh_count > 0)
    lod_scene_warn(reader->scene, "The file has no nodes; every mesh was placed at the origin.");
  for (uint32_t m = 0; m < gltf->mesh_count; m++) {
    LOD_TRY(lod_reader_add_instances(reader, 1));
    LOD_TRY(lod_gltf_read_mesh(import->document, import->materials, m, NULL, 0, pieces));
    LOD_TRY(add_pieces(import, gltf->meshes[m].name, pieces, NULL, 0));
  }
  return LOD_OK;
}

static enum lod_status import_document(struct import *import) {
  struct lod_gltf_document *document = import->document;
  const struct lod_gltf *gltf = &document->gltf;
  struct lod_arena *scratch = document->reader->scratch;
  LOD_TRY(lod_gltf_materials_create(document, &import->materials));
  if (gltf->node_count == 0)
    return add_loose_meshes(import);
  import->parents = LOD_NEW(scratch, gltf->node_count, uint32_t);
  import->worlds = lod_arena_calloc(scratch, gltf->node_count, sizeof *import->worlds);
  import->in_scene = LOD_NEW_ZERO(scratch, gltf->node_count, bool);
  import->instances_of = LOD_NEW_ZERO(scratch, gltf->mesh_count, uint32_t);
  if (!import->parents || !import->worlds || !import->in_scene || !import->instances_of)
    return lod_reader_memory(document->reader);
  LOD_TRY(find_parents(import));
  LOD_TRY(find_worlds(import));
  LOD_TRY(mark_scene(import));
  LOD_TRY(count_instances(import));
  LOD_TRY(add_meshes(import));
  for (uint32_t n = 0; n < gltf->node_count; n++)
    if (is_placed(import, n) && is_skinned(import, n))
      LOD_TRY(add_skinned(import, n));
  return LOD_OK;
}

enum lod_status lod_import_gltf(struct lod_reader *reader) {
  struct lod_gltf_document document;
  struct import import = {.document = &document};
  enum lod_status status = lod_gltf_document_init(&document, reader);
  if (status == LOD_OK)
    status = import_document(&import);
  lod_gltf_document_finish(&document);
  return status;
}
