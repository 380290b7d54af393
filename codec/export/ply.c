#include "codec/export/ply.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Which PLY vertex a corner, edge or point refers to: wedges first, then vertices that have none. */
struct numbering {
  uint32_t *of_vertex; /* LOD_NONE until asked for */
  uint32_t count;
  uint32_t *bare; /* vertices behind the wedges */
  uint32_t bare_count;
};

static bool number_vertices(const struct lod_mesh *mesh, struct lod_arena *arena, struct numbering *numbering) {
  numbering->of_vertex = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  numbering->bare = LOD_NEW(arena, mesh->vertex_count, uint32_t);
  if (numbering->of_vertex == NULL || numbering->bare == NULL)
    return false;
  memset(numbering->of_vertex, 0xff, (size_t)mesh->vertex_count * sizeof *numbering->of_vertex);
  for (uint32_t w = mesh->wedge_count; w-- > 0;)
    numbering->of_vertex[mesh->wedge_vertex[w]] = w;
  numbering->bare_count = 0;
  for (uint32_t v = 0; v < mesh->vertex_count; v++)
    if (numbering->of_vertex[v] == LOD_NONE) {
      numbering->of_vertex[v] = mesh->wedge_count + numbering->bare_count;
      numbering->bare[numbering->bare_count++] = v;
    }
  numbering->count = mesh->wedge_count + numbering->bare_count;
  return true;
}

/* ---- output ---- */

struct sink {
  FILE *file;
  uint8_t buffer[65536];
  size_t used;
  bool failed;
};

static void flush(struct sink *sink) {
  if (sink->used > 0 && !sink->failed && fwrite(sink->buffer, 1, sink->used, sink->file) != sink->used)
    sink->failed = true;
  sink->used = 0;
}

static void put_bytes(struct sink *sink, const void *bytes, size_t size) {
  if (sink->used + size > sizeof sink->buffer)
    flush(sink);
  memcpy(sink->buffer + sink->used, bytes, size);
  sink->used += size;
}

static void put_u32(struct sink *sink, uint32_t value) {
  const uint8_t bytes[4] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)};
  put_bytes(sink, bytes, 4);
}

static void put_float(struct sink *sink, float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  put_u32(sink, bits);
}

static uint8_t srgb(float linear) {
  const double v = (double)linear, s = v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - 0.055;
  return (uint8_t)floor(fmin(fmax(s, 0), 1) * 255 + 0.5);
}

static void put_header(const struct lod_mesh *mesh, const struct numbering *numbering, const char *comment, struct sink *sink) {
  char text[1024];
  int length = snprintf(text, sizeof text, "ply\nformat binary_little_endian 1.0\n");
  if (comment != NULL)
    length += snprintf(text + length, 300, "comment %.250s\n", comment);
  length += snprintf(text + length, sizeof text - (size_t)length,
                     "element vertex %u\nproperty float x\nproperty float y\nproperty float z\n%s%s%s", numbering->count,
                     mesh->normals != NULL ? "property float nx\nproperty float ny\nproperty float nz\n" : "",
                     mesh->uvs[0] != NULL ? "property float s\nproperty float t\n" : "",
                     mesh->colors != NULL ? "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n" : "");
  length += snprintf(text + length, sizeof text - (size_t)length, "element face %u\nproperty list uchar int vertex_indices\n",
                     mesh->triangle_count);
  if (mesh->edge_count > 0)
    length += snprintf(text + length, sizeof text - (size_t)length,
                       "element edge %u\nproperty int vertex1\nproperty int vertex2\nproperty float thickness\n", mesh->edge_count);
  length += snprintf(text + length, sizeof text - (size_t)length, "end_header\n");
  assert((size_t)length < sizeof text);
  put_bytes(sink, text, (size_t)length);
}

/* wedge: LOD_NONE = a vertex without one. */
static void put_vertex(const struct lod_mesh *mesh, uint32_t vertex, uint32_t wedge, struct sink *sink) {
  for (int i = 0; i < 3; i++)
    put_float(sink, mesh->positions[vertex][i]);
  for (int i = 0; i < 3 && mesh->normals != NULL; i++)
    put_float(sink, wedge != LOD_NONE ? mesh->normals[wedge][i] : 0);
  if (mesh->uvs[0] != NULL) {
    put_float(sink, wedge != LOD_NONE ? mesh->uvs[0][wedge][0] : 0);
    put_float(sink, wedge != LOD_NONE ? 1 - mesh->uvs[0][wedge][1] : 0);
  }
  for (int i = 0; i < 4 && mesh->colors != NULL; i++) {
    const float value = wedge != LOD_NONE ? mesh->colors[wedge][i] : 1;
    const uint8_t byte = i < 3 ? srgb(value) : (uint8_t)floor(fmin(fmax((double)value, 0), 1) * 255 + 0.5);
    put_bytes(sink, &byte, 1);
  }
}

static void put_elements(const struct lod_mesh *mesh, const struct numbering *numbering, struct sink *sink) {
  for (uint32_t w = 0; w < mesh->wedge_count; w++)
    put_vertex(mesh, mesh->wedge_vertex[w], w, sink);
  for (uint32_t i = 0; i < numbering->bare_count; i++)
    put_vertex(mesh, numbering->bare[i], LOD_NONE, sink);
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    const uint8_t three = 3;
    put_bytes(sink, &three, 1);
    for (int c = 0; c < 3; c++)
      put_u32(sink, mesh->corners != NULL ? mesh->corners[t][c] : numbering->of_vertex[mesh->triangles[t][c]]);
  }
  for (uint32_t e = 0; e < mesh->edge_count; e++) {
    put_u32(sink, numbering->of_vertex[mesh->edges[e][0]]);
    put_u32(sink, numbering->of_vertex[mesh->edges[e][1]]);
    put_float(sink, mesh->edge_thickness != NULL ? mesh->edge_thickness[e] : 0);
  }
}

enum lod_status lod_ply_write(const struct lod_mesh *mesh, const char *comment, FILE *file, struct lod_problem *problem) {
  struct lod_arena *arena = lod_arena_create(0);
  struct sink *sink = malloc(sizeof *sink);
  struct numbering numbering;
  enum lod_status status = LOD_OK;
  if (arena == NULL || sink == NULL || !number_vertices(mesh, arena, &numbering))
    status = lod_fail_memory(problem);
  else if (numbering.count > INT32_MAX || numbering.count < mesh->wedge_count)
    status = lod_fail(problem, LOD_LIMIT, "limit-vertices", "%u vertices are more than a PLY's int can count", numbering.count);
  if (status == LOD_OK) {
    sink->file = file;
    sink->used = 0;
    sink->failed = false;
    put_header(mesh, &numbering, comment, sink);
    put_elements(mesh, &numbering, sink);
    flush(sink);
    if (sink->failed || fflush(file) != 0)
      status = lod_fail(problem, LOD_IO, "write", "The PLY cannot be written");
  }
  free(sink);
  lod_arena_destroy(arena);
  return status;
}

enum lod_status lod_ply_encode(const struct lod_mesh *mesh, const char *comment, struct lod_arena *arena, uint8_t **bytes, size_t *size,
                               struct lod_problem *problem) {
  char *buffer = NULL;
  size_t length = 0;
  FILE *file = open_memstream(&buffer, &length);
  if (file == NULL)
    return lod_fail_memory(problem);
  enum lod_status status = lod_ply_write(mesh, comment, file, problem);
  if (fclose(file) != 0 && status == LOD_OK)
    status = lod_fail_memory(problem);
  if (status == LOD_OK) {
    *bytes = lod_arena_copy(arena, buffer, length);
    *size = length;
    if (*bytes == NULL)
      status = lod_fail_memory(problem);
  }
  free(buffer);
  return status;
}
