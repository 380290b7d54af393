/* OFF, FBX, Collada, 3MF, 3DS and whatever else assimp reads.
 *
 * assimp gets no post-processing step: it neither triangulates nor welds nor makes normals, that is ours. It sees one file, and through our
 * callbacks the files beside it that the caller offers; it never opens anything itself. Its importers are not written for hostile bytes,
 * which is why a worker is jailed; what is cheap to check beforehand (counts that allocate, nesting that recurses) is checked here.
 *
 * Rounding: assimp parses decimals with fast_atof, whose integer and fraction parts and their sum are floats, times a float power of ten
 * where there is an exponent: fewer than 8 roundings of 2^-24 each. */
#include "codec/import/assimp_assert.h"
#include "codec/import/assimp_material.h"

#include <assimp/cfileio.h>
#include <assimp/cimport.h>
#include <assimp/config.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "codec/import/polygons.h"
#include "codec/import/reader.h"

_Static_assert(sizeof(ai_real) == sizeof(float), "assimp is built with float coordinates");

/* --- files in memory --- */

struct memory_file {
  struct aiFile file;
  const uint8_t *bytes;
  size_t size, at;
};

struct memory_io {
  struct aiFileIO io;
  struct lod_reader *reader;
  char root[96]; /* "duck.dae" */
  size_t stem;   /* length of "duck." */
};

static size_t file_read(struct aiFile *file, char *out, size_t size, size_t count) {
  struct memory_file *memory = (struct memory_file *)(void *)file->UserData;
  size_t left = memory->size - memory->at;
  if (size == 0 || count == 0)
    return 0;
  size_t items = left / size < count ? left / size : count;
  memcpy(out, memory->bytes + memory->at, items * size);
  memory->at += items * size;
  return items;
}

static size_t file_write(struct aiFile *file, const char *bytes, size_t size, size_t count) {
  (void)file, (void)bytes, (void)size, (void)count;
  return 0;
}

static size_t file_tell(struct aiFile *file) {
  return ((struct memory_file *)(void *)file->UserData)->at;
}
static size_t file_size(struct aiFile *file) {
  return ((struct memory_file *)(void *)file->UserData)->size;
}
static void file_flush(struct aiFile *file) {
  (void)file;
}

static aiReturn file_seek(struct aiFile *file, size_t offset, enum aiOrigin origin) {
  struct memory_file *memory = (struct memory_file *)(void *)file->UserData;
  /* Offsets are unsigned, yet importers pass negative ones from the end. */
  size_t base = origin == aiOrigin_SET ? 0 : (origin == aiOrigin_CUR ? memory->at : memory->size);
  size_t target = base + offset;
  if (target > memory->size)
    return aiReturn_FAILURE;
  memory->at = target;
  return aiReturn_SUCCESS;
}

static bool has_file(struct lod_reader *reader, const char *name) {
  struct lod_problem *outer = reader->problem, local = {0};
  const uint8_t *bytes;
  size_t size;
  reader->problem = &local;
  enum lod_status status = lod_reader_open_path(reader, name, reader->scratch, &bytes, &size);
  reader->problem = outer;
  return status == LOD_OK;
}

static struct aiFile *io_open(struct aiFileIO *io, const char *name, const char *mode) {
  struct memory_io *memory = (struct memory_io *)(void *)io->UserData;
  struct lod_reader *reader = memory->reader;
  const uint8_t *bytes = reader->bytes;
  size_t size = reader->size;
  if (strchr(mode, 'w') || strchr(mode, 'a') || strchr(mode, '+'))
    return NULL;
  /* Guesses of assimp's ("duck.mtl" for duck.x): quietly nothing when they are not there. */
  bool guess = strcmp(name, memory->root) != 0 && strncmp(name, memory->root, memory->stem) == 0;
  if (guess && !has_file(reader, name))
    return NULL;
  if (strcmp(name, memory->root) != 0 && lod_reader_open_companion(reader, name, reader->scratch, &bytes, &size) != LOD_OK)
    return NULL;
  struct memory_file *file = bytes ? LOD_NEW_ZERO(reader->scratch, 1, struct memory_file) : NULL;
  if (!file)
    return NULL;
  *file = (struct memory_file){.bytes = bytes, .size = size};
  file->file = (struct aiFile){.ReadProc = file_read,
                               .WriteProc = file_write,
                               .TellProc = file_tell,
                               .FileSizeProc = file_size,
                               .SeekProc = file_seek,
                               .FlushProc = file_flush,
                               .UserData = (aiUserData)(void *)file};
  return &file->file;
}

static void io_close(struct aiFileIO *io, struct aiFile *file) {
  (void)io, (void)file;
}

/* --- checks before assimp sees the bytes --- */

/* Nested elements of XML, nested braces of .x, FBX text and VRML: their importers recurse. */
static enum lod_status check_depth(struct lod_reader *reader) {
  const char *text = (const char *)reader->bytes;
  bool xml = reader->bytes[0] == '<' || reader->bytes[0] == 0xEF;
  uint32_t depth = 0;
  for (size_t i = 0; i + 1 < reader->size; i++) {
    bool opens = xml ? text[i] == '<' && text[i + 1] != '/' && text[i + 1] != '!' && text[i + 1] != '?' : text[i] == '{';
    bool closes = xml ? (text[i] == '<' && text[i + 1] == '/') || (text[i] == '/' && text[i + 1] == '>') : text[i] == '}';
    if (opens && ++depth > reader->limits.max_depth)
      return lod_reader_fail(reader, LOD_LIMIT, "limit-depth", "the file is nested deeper than %u", reader->limits.max_depth);
    if (closes && depth > 0)
      depth--;
  }
  return LOD_OK;
}

static enum lod_status check_before(struct lod_reader *reader) {
  static const char *const kNested[] = {"dae", "amf", "x3d", "xgl", "x", "fbx", "wrl"};
  for (size_t i = 0; i < sizeof kNested / sizeof *kNested; i++)
    if (strcmp(reader->format, kNested[i]) == 0 && memcmp(reader->bytes, "Kaydara", reader->size < 7 ? reader->size : 7) != 0)
      LOD_TRY(check_depth(reader));
  return LOD_OK;
}

/* --- meshes --- */

struct conversion {
  struct lod_reader *reader;
  const struct aiScene *scene;
  uint32_t *materials;       /* mNumMaterials */
  uint32_t *instance_counts; /* mNumMeshes */
  double (**instances)[16];  /* mNumMeshes */
};

static enum lod_status copy_vertices(struct conversion *conversion, const struct aiMesh *from, struct lod_mesh *mesh) {
  struct lod_arena *arena = conversion->reader->scratch;
  uint32_t count = from->mNumVertices;
  mesh->vertex_count = count;
  bool ok = (mesh->positions = lod_arena_alloc(arena, count, sizeof *mesh->positions)) != NULL;
  ok = ok && (!from->mNormals || (mesh->normals = lod_arena_alloc(arena, count, sizeof *mesh->normals)) != NULL);
  for (int set = 0; set < LOD_UV_SETS; set++)
    ok = ok && (!from->mTextureCoords[set] || (mesh->uvs[set] = lod_arena_alloc(arena, count, sizeof *mesh->uvs[set])) != NULL);
  ok = ok && (!from->mColors[0] || (mesh->colors = lod_arena_alloc(arena, count, sizeof *mesh->colors)) != NULL);
  if (!ok)
    return lod_reader_memory(conversion->reader);
  for (uint32_t v = 0; v < count; v++) {
    memcpy(mesh->positions[v], &from->mVertices[v], sizeof *mesh->positions);
    if (mesh->normals)
      memcpy(mesh->normals[v], &from->mNormals[v], sizeof *mesh->normals);
    /* v points up in these formats, down in glTF. */
    for (int set = 0; set < LOD_UV_SETS; set++)
      if (mesh->uvs[set]) {
        mesh->uvs[set][v][0] = from->mTextureCoords[set][v].x;
        mesh->uvs[set][v][1] = 1 - from->mTextureCoords[set][v].y;
      }
    if (mesh->colors) {
      const struct aiColor4D *color = &from->mColors[0][v];
      const float rgba[4] = {lod_linear_from_srgb(color->r), lod_linear_from_srgb(color->g), lod_linear_from_srgb(color->b), color->a};
      memcpy(mesh->colors[v], rgba, sizeof rgba);
    }
  }
  return LOD_OK;
}

/* Faces of one and two indices are points and lines. */
static enum lod_status copy_faces(struct conversion *conversion, const struct aiMesh *from, struct lod_mesh *mesh) {
  struct lod_reader *reader = conversion->reader;
  struct lod_polygons polygons;
  LOD_TRY(lod_polygons_init(&polygons, reader, from->mNumFaces));
  mesh->edges = lod_arena_alloc(reader->scratch, from->mNumFaces, sizeof *mesh->edges);
  mesh->points = LOD_NEW(reader->scratch, from->mNumFaces, uint32_t);
  if (!mesh->edges || !mesh->points)
    return lod_reader_memory(reader);
  for (uint32_t f = 0; f < from->mNumFaces; f++) {
    const struct aiFace *face = &from->mFaces[f];
    if (face->mNumIndices == 1)
      mesh->points[mesh->point_count++] = face->mIndices[0];
    else if (face->mNumIndices == 2)
      memcpy(mesh->edges[mesh->edge_count++], face->mIndices, sizeof *mesh->edges);
    if (face->mNumIndices < 3)
      continue;
    uint32_t *corners = lod_polygons_begin(&polygons, reader, face->mNumIndices);
    if (!corners)
      return LOD_MEMORY;
    memcpy(corners, face->mIndices, face->mNumIndices * sizeof *corners);
    LOD_TRY(lod_polygons_end(&polygons, reader, face->mNumIndices));
  }
  struct lod_polygon_triangles triangles;
  LOD_TRY(lod_polygons_triangulate(&polygons, reader, mesh->positions, mesh->vertex_count, false, &triangles));
  mesh->triangles = triangles.triangles;
  mesh->triangle_count = triangles.count;
  return LOD_OK;
}

static enum lod_status set_material(struct conversion *conversion, uint32_t number, struct lod_mesh *mesh) {
  uint32_t material = number < conversion->scene->mNumMaterials ? conversion->materials[number] : LOD_NONE;
  if (material == LOD_NONE)
    return LOD_OK;
  struct lod_arena *arena = conversion->reader->scratch;
  mesh->materials = LOD_NEW(arena, mesh->triangle_count, uint32_t);
  mesh->edge_materials = LOD_NEW(arena, mesh->edge_count, uint32_t);
  mesh->point_materials = LOD_NEW(arena, mesh->point_count, uint32_t);
  if (!mesh->materials || !mesh->edge_materials || !mesh->point_materials)
    return lod_reader_memory(conversion->reader);
  for (uint32_t i = 0; i < mesh->triangle_count; i++)
    mesh->materials[i] = material;
  for (uint32_t i = 0; i < mesh->edge_count; i++)
    mesh->edge_materials[i] = material;
  for (uint32_t i = 0; i < mesh->point_count; i++)
    mesh->point_materials[i] = material;
  return LOD_OK;
}

static double magnitude_of(const struct lod_mesh *mesh) {
  double largest = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    for (int axis = 0; axis < 3; axis++)
      if (isfinite(mesh->positions[v][axis]))
        largest = fmax(largest, fabs((double)mesh->positions[v][axis]));
  return largest;
}

static enum lod_status add_mesh(struct conversion *conversion, uint32_t number) {
  struct lod_reader *reader = conversion->reader;
  const struct aiMesh *from = conversion->scene->mMeshes[number];
  struct lod_mesh mesh = {0};
  if (!from->mVertices || from->mNumVertices == 0)
    return LOD_OK;
  LOD_TRY(lod_reader_add_vertices(reader, from->mNumVertices));
  LOD_TRY(copy_vertices(conversion, from, &mesh));
  LOD_TRY(copy_faces(conversion, from, &mesh));
  LOD_TRY(set_material(conversion, from->mMaterialIndex, &mesh));
  if (lod_scene_share_index(&mesh, reader->scratch) != LOD_OK)
    return lod_reader_memory(reader);
  if (from->mNumBones > 0)
    lod_scene_warn(reader->scene, "Skins were dropped; the model is in its rest pose.");
  if (from->mNumAnimMeshes > 0)
    lod_scene_warn(reader->scene, "Morph targets were dropped; the model is in its rest pose.");
  struct lod_scene_part part = {.name = from->mName.data,
                                .mesh = mesh,
                                .rounding = 1.7321 * 8 * 0x1p-24 * magnitude_of(&mesh),
                                .instance_count = conversion->instance_counts[number],
                                .instances = conversion->instances[number]};
  return lod_scene_add_part(reader->scene, &part, reader->name, reader->problem);
}

/* --- nodes --- */

static void to_columns(const struct aiMatrix4x4 *m, double out[16]) {
  const ai_real rows[16] = {m->a1, m->a2, m->a3, m->a4, m->b1, m->b2, m->b3, m->b4, m->c1, m->c2, m->c3, m->c4, m->d1, m->d2, m->d3, m->d4};
  for (int row = 0; row < 4; row++)
    for (int column = 0; column < 4; column++)
      out[column * 4 + row] = (double)rows[row * 4 + column];
}

/* Visits every node with its world matrix: once to count the instances of each mesh, once to write them. */
struct frame {
  const struct aiNode *node;
  uint32_t child;
  double world[16];
};

static enum lod_status visit(struct conversion *conversion, const struct frame *frame, bool write) {
  for (uint32_t i = 0; i < frame->node->mNumMeshes; i++) {
    uint32_t mesh = frame->node->mMeshes[i];
    if (mesh >= conversion->scene->mNumMeshes)
      return lod_reader_bad(conversion->reader, "index-out-of-range", "a node refers to a mesh that does not exist");
    if (write)
      memcpy(conversion->instances[mesh][conversion->instance_counts[mesh]], frame->world, sizeof frame->world);
    else
      LOD_TRY(lod_reader_add_instances(conversion->reader, 1));
    conversion->instance_counts[mesh]++;
  }
  return LOD_OK;
}

static enum lod_status walk(struct conversion *conversion, bool write) {
  struct lod_reader *reader = conversion->reader;
  struct frame *stack = LOD_NEW(reader->scratch, (size_t)reader->limits.max_depth + 1, struct frame);
  uint32_t depth = 0;
  if (!stack)
    return lod_reader_memory(reader);
  stack[0].node = conversion->scene->mRootNode;
  stack[0].child = 0;
  to_columns(&stack[0].node->mTransformation, stack[0].world);
  LOD_TRY(visit(conversion, &stack[0], write));
  for (;;) {
    struct frame *top = &stack[depth];
    if (top->child == top->node->mNumChildren) {
      if (depth-- == 0)
        return LOD_OK;
      continue;
    }
    const struct aiNode *node = top->node->mChildren[top->child++];
    if (++depth > reader->limits.max_depth)
      return lod_reader_fail(reader, LOD_LIMIT, "limit-depth", "the node tree is deeper than %u", reader->limits.max_depth);
    double local[16];
    stack[depth].node = node;
    stack[depth].child = 0;
    to_columns(&node->mTransformation, local);
    lod_matrix_multiply(top->world, local, stack[depth].world);
    LOD_TRY(visit(conversion, &stack[depth], write));
  }
}

static enum lod_status find_instances(struct conversion *conversion) {
  struct lod_arena *arena = conversion->reader->scratch;
  uint32_t count = conversion->scene->mNumMeshes;
  conversion->instance_counts = LOD_NEW_ZERO(arena, count, uint32_t);
  conversion->instances = lod_arena_calloc(arena, count, sizeof *conversion->instances);
  if (!conversion->instance_counts || !conversion->instances)
    return lod_reader_memory(conversion->reader);
  LOD_TRY(walk(conversion, false));
  for (uint32_t m = 0; m < count; m++) {
    conversion->instances[m] = lod_arena_alloc(arena, conversion->instance_counts[m], sizeof **conversion->instances);
    if (!conversion->instances[m])
      return lod_reader_memory(conversion->reader);
    conversion->instance_counts[m] = 0;
  }
  return walk(conversion, true);
}

/* --- all together --- */

static enum lod_status convert(struct lod_reader *reader, const struct aiScene *scene) {
  struct conversion conversion = {.reader = reader, .scene = scene};
  if (!scene->mRootNode)
    return lod_reader_bad(reader, "empty", "there is no scene in the file");
  LOD_TRY(find_instances(&conversion));
  conversion.materials = LOD_NEW(reader->scratch, scene->mNumMaterials, uint32_t);
  if (!conversion.materials)
    return lod_reader_memory(reader);
  for (uint32_t m = 0; m < scene->mNumMaterials; m++)
    conversion.materials[m] = LOD_NONE;
  for (uint32_t m = 0; m < scene->mNumMeshes; m++) {
    uint32_t material = scene->mMeshes[m]->mMaterialIndex;
    if (conversion.instance_counts[m] == 0)
      continue;
    if (material < scene->mNumMaterials && conversion.materials[material] == LOD_NONE)
      LOD_TRY(lod_assimp_material(reader, scene, material, &conversion.materials[material]));
    LOD_TRY(add_mesh(&conversion, m));
  }
  if (scene->mNumAnimations > 0)
    lod_scene_warn(reader->scene, "Animations were dropped; the model is in its rest pose.");
  return LOD_OK;
}

/* The file's own name with the ending that the content asks for, where it is harmless; assimp looks for companions under it. */
static void name_root(struct memory_io *memory) {
  const char *name = memory->reader->name, *dot = strrchr(name, '.');
  size_t length = dot ? (size_t)(dot - name) : strlen(name);
  bool plain = length > 0 && length < 64 && name[0] != '.';
  for (size_t i = 0; i < length; i++)
    plain = plain && (unsigned char)name[i] >= 0x20 && !strchr("/\\:*?\"<>|", name[i]);
  memory->stem = (size_t)snprintf(memory->root, sizeof memory->root, "%.*s.", plain ? (int)length : 5, plain ? name : "model");
  snprintf(memory->root + memory->stem, sizeof memory->root - memory->stem, "%.15s", memory->reader->format);
}

enum lod_status lod_import_assimp(struct lod_reader *reader) {
  struct memory_io memory = {.reader = reader};
  LOD_TRY(check_before(reader));
  lod_assimp_catch_assertions();
  memory.io = (struct aiFileIO){.OpenProc = io_open, .CloseProc = io_close, .UserData = (aiUserData)(void *)&memory};
  name_root(&memory);
  struct aiPropertyStore *properties = aiCreatePropertyStore();
  if (!properties)
    return lod_reader_memory(reader);
  /* Pivots as extra nodes say nothing to a model that does not move. */
  aiSetImportPropertyInteger(properties, AI_CONFIG_IMPORT_FBX_PRESERVE_PIVOTS, 0);
  const struct aiScene *scene = aiImportFileExWithProperties(memory.root, 0, &memory.io, properties);
  aiReleasePropertyStore(properties);
  if (!scene)
    return lod_reader_bad(reader, "bad-content", "cannot be read as %s: %s", reader->format, aiGetErrorString());
  enum lod_status status = convert(reader, scene);
  aiReleaseImport(scene);
  return status;
}
