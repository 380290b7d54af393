/* Writes bake directories as a worker would, for the tests of store and jobs. The "GLBs" are any bytes: the store does not look inside. */
#ifndef LOD_TESTS_BAKE_FOLDER_H
#define LOD_TESTS_BAKE_FOLDER_H

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/store/intake.h"

enum { BAKE_MAX_LEVELS = 8 };

struct bake_level {
  const char *content; /* of the object */
  size_t size;         /* 0: strlen(content) */
};

static inline int write_file_at(int folder_fd, const char *name, const void *bytes, size_t size) {
  int fd = openat(folder_fd, name, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
  if (fd < 0 || write(fd, bytes, size) != (ssize_t)size)
    return -1;
  return close(fd);
}

/* The manifest of such a folder; free it. texture: content of a picture, or NULL. (Inlined, gcc 12 takes what open_memstream made for
 * the variable that points to it.) */
__attribute__((noinline, unused)) static char *bake_manifest(const char *id, const char *revision, const struct bake_level *levels,
                                                             size_t count, const char *texture) {
  char *text;
  size_t size;
  char digest[LOD_SHA256_HEX + 1];
  FILE *out = open_memstream(&text, &size);
  fprintf(out,
          "{\"id\":\"%s\",\"revision\":\"%s\",\"source\":{\"format\":\"ply\",\"name\":\"cube.ply\",\"sha256\":\"%064d\",\"bytes\":1000,"
          "\"vertices\":8,\"triangles\":12,\"components\":1,\"boundary_loops\":0,\"closed\":true,\"diagonal\":1.7320508075688772,"
          "\"bounds\":{\"min\":[0,0,0],\"max\":[1,1,1]},\"sphere\":{\"center\":[0.5,0.5,0.5],\"radius\":0.87}},"
          "\"families\":{\"cluster\":{\"nested\":true,\"levels\":[",
          id, revision, 7);
  for (size_t i = 0; i < count; i++) {
    size_t bytes = levels[i].size != 0 ? levels[i].size : strlen(levels[i].content);
    lod_sha256_text(levels[i].content, bytes, digest);
    fprintf(out,
            "%s{\"level\":%zu,\"vertices\":%zu,\"triangles\":%zu,\"edges\":0,\"points\":0,\"error\":%.17g,\"error_lower\":%.17g,"
            "\"cell\":%.17g,\"bytes\":%zu,\"object\":\"%s\",\"type\":\"model/gltf-binary\"}",
            i == 0 ? "" : ",", i, 4 + i, 10 * (i + 1), 0.1 / (double)(i + 1), 0.09 / (double)(i + 1), 0.5, bytes, digest);
  }
  fprintf(out, "]}},\"parts\":[{\"name\":\"cube\",\"instances\":[[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]],\"families\":{}}],\"textures\":[");
  if (texture != NULL) {
    lod_sha256_text(texture, strlen(texture), digest);
    fprintf(out, "{\"object\":\"%s\",\"type\":\"image/png\",\"bytes\":%zu,\"width\":1,\"height\":1}", digest, strlen(texture));
  }
  fprintf(out, "],\"bake\":{\"settings\":{},\"seconds\":0.5,\"warnings\":[]}}");
  fclose(out);
  return text;
}

/* Objects and manifest into an existing empty folder. 0, or -1. */
static inline int write_bake(int folder_fd, const char *id, const char *revision, const struct bake_level *levels, size_t count,
                             const char *texture) {
  char digest[LOD_SHA256_HEX + 1];
  mkdirat(folder_fd, "objects", 0700);
  int objects_fd = openat(folder_fd, "objects", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  int result = objects_fd < 0 ? -1 : 0;
  for (size_t i = 0; i < count && result == 0; i++) {
    size_t bytes = levels[i].size != 0 ? levels[i].size : strlen(levels[i].content);
    lod_sha256_text(levels[i].content, bytes, digest);
    result = write_file_at(objects_fd, digest, levels[i].content, bytes);
  }
  if (texture != NULL && result == 0) {
    lod_sha256_text(texture, strlen(texture), digest);
    result = write_file_at(objects_fd, digest, texture, strlen(texture));
  }
  if (objects_fd >= 0)
    close(objects_fd);
  char *text = bake_manifest(id, revision, levels, count, texture);
  if (result == 0)
    result = write_file_at(folder_fd, "manifest.json", text, strlen(text));
  free(text);
  return result;
}

#endif
