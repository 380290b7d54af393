#include "codec/export/png.h"

#include <errno.h>
#include <png.h>
#include <stdlib.h>
#include <string.h>

static bool is_opaque(const struct lod_picture *picture) {
  for (size_t i = 0; i < (size_t)picture->width * picture->height; i++)
    if (picture->rgba[i][3] != 255)
      return false;
  return true;
}

/* libpng's own simplified interface wants RGB packed for RGB out. */
static uint8_t *pack(const struct lod_picture *picture, bool opaque) {
  const size_t count = (size_t)picture->width * picture->height, channels = opaque ? 3 : 4;
  uint8_t *packed = malloc(count * channels);
  for (size_t i = 0; i < count && packed != NULL; i++)
    memcpy(packed + channels * i, picture->rgba[i], channels);
  return packed;
}

/* Calls libpng to write to `file`, or to *bytes (malloc'd) when file is NULL. */
static enum lod_status write_png(const struct lod_picture *picture, FILE *file, uint8_t **bytes, size_t *size,
                                 struct lod_problem *problem) {
  const bool opaque = is_opaque(picture);
  uint8_t *packed = pack(picture, opaque);
  if (packed == NULL)
    return lod_fail_memory(problem);
  png_image image = {.version = PNG_IMAGE_VERSION,
                     .width = picture->width,
                     .height = picture->height,
                     .format = opaque ? PNG_FORMAT_RGB : PNG_FORMAT_RGBA};
  int good;
  if (file != NULL) {
    good = png_image_write_to_stdio(&image, file, 0, packed, 0, NULL);
  } else {
    png_alloc_size_t needed = PNG_IMAGE_PNG_SIZE_MAX(image);
    *bytes = malloc(needed);
    good = *bytes != NULL && png_image_write_to_memory(&image, *bytes, &needed, 0, packed, 0, NULL);
    *size = needed;
  }
  free(packed);
  if (good)
    return LOD_OK;
  enum lod_status status =
      file == NULL ? lod_fail_memory(problem) : lod_fail(problem, LOD_IO, "write", "The picture cannot be written: %s", image.message);
  png_image_free(&image);
  return status;
}

enum lod_status lod_png_write(const struct lod_picture *picture, FILE *file, struct lod_problem *problem) {
  return write_png(picture, file, NULL, NULL, problem);
}

enum lod_status lod_png_encode(const struct lod_picture *picture, struct lod_arena *arena, uint8_t **bytes, size_t *size,
                               struct lod_problem *problem) {
  uint8_t *buffer = NULL;
  enum lod_status status = write_png(picture, NULL, &buffer, size, problem);
  if (status == LOD_OK) {
    *bytes = lod_arena_copy(arena, buffer, *size);
    if (*bytes == NULL)
      status = lod_fail_memory(problem);
  }
  free(buffer);
  return status;
}
