#include "tests/data/ply.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

struct header {
  uint32_t vertices, faces, stride, face_tail;
  bool binary, xyz;
};

static uint32_t size_of(const char *type) {
  static const char *const kNames[] = {"char", "uchar", "short", "ushort", "int",   "uint",   "float",   "double",
                                       "int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"};
  static const uint32_t kSizes[] = {1, 1, 2, 2, 4, 4, 4, 8, 1, 1, 2, 2, 4, 4, 4, 8};
  for (size_t i = 0; i < sizeof kSizes / sizeof *kSizes; i++)
    if (strcmp(type, kNames[i]) == 0)
      return kSizes[i];
  return 0;
}

static bool read_header(FILE *file, struct header *header) {
  char line[512], element[64] = "", type[64], name[64];
  int properties = 0;
  *header = (struct header){0};
  while (fgets(line, sizeof line, file) != NULL) {
    uint32_t count;
    if (strncmp(line, "end_header", 10) == 0)
      return header->binary && header->xyz;
    if (strstr(line, "format binary_little_endian") == line)
      header->binary = true;
    else if (sscanf(line, "element %63s %u", element, &count) == 2)
      *(strcmp(element, "vertex") == 0 ? &header->vertices : &header->faces) = count;
    else if (sscanf(line, "property list %63s %63s", type, name) == 2)
      continue;
    else if (sscanf(line, "property %63s %63s", type, name) == 2) {
      if (strcmp(element, "vertex") == 0) {
        if (properties == 2)
          header->xyz = header->stride == 8 && strcmp(name, "z") == 0;
        properties++;
        header->stride += size_of(type);
      } else {
        header->face_tail += size_of(type);
      }
    }
  }
  return false;
}

static void *need(void *pointer) {
  if (pointer == NULL)
    abort();
  return pointer;
}

static bool read_faces(FILE *file, const struct header *header, struct lod_mesh *mesh) {
  for (uint32_t f = 0; f < header->faces; f++) {
    unsigned char count;
    uint32_t index[255];
    char tail[256];
    if (fread(&count, 1, 1, file) != 1 || fread(index, 4, count, file) != count || header->face_tail > sizeof tail ||
        fread(tail, 1, header->face_tail, file) != header->face_tail || count != 3)
      return false;
    for (int k = 0; k < 3; k++) {
      if (index[k] >= header->vertices)
        return false;
      mesh->triangles[f][k] = index[k];
    }
  }
  return true;
}

bool lod_ply_read(const char *path, struct lod_arena *arena, struct lod_mesh *mesh) {
  FILE *file = fopen(path, "rb");
  struct header header;
  bool good = file != NULL && read_header(file, &header);
  if (good) {
    *mesh = (struct lod_mesh){.vertex_count = header.vertices, .triangle_count = header.faces};
    mesh->positions = need(lod_arena_alloc(arena, header.vertices, sizeof *mesh->positions));
    mesh->triangles = need(lod_arena_alloc(arena, header.faces, sizeof *mesh->triangles));
    char vertex[1024];
    for (uint32_t v = 0; good && v < header.vertices; v++) {
      good = header.stride <= sizeof vertex && fread(vertex, 1, header.stride, file) == header.stride;
      memcpy(mesh->positions[v], vertex, sizeof *mesh->positions);
    }
    good = good && read_faces(file, &header, mesh);
  }
  if (file != NULL)
    fclose(file);
  return good;
}

const char *lod_shared_folder(void) {
  const char *folder = getenv("LODESTREAM_SHARED");
  struct stat info;
  folder = folder != NULL ? folder : "../shared";
  return stat(folder, &info) == 0 && S_ISDIR(info.st_mode) ? folder : NULL;
}
