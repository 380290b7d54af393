/* Encoded pictures: which format, how large, without decoding them.
 *
 * Based on: PNG (RFC 2083, 4.1.1), JPEG (ITU-T T.81, B.2.2), WebP (RFC 9649, 2.5 to 2.7), KTX 2.0 (Khronos, 3). */
#include <string.h>

#include "codec/import/reader.h"

static uint32_t big_u16(const uint8_t *p) {
  return (uint32_t)p[0] << 8 | p[1];
}
static uint32_t big_u32(const uint8_t *p) {
  return big_u16(p) << 16 | big_u16(p + 2);
}
static uint32_t little_u24(const uint8_t *p) {
  return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16;
}
static uint32_t little_u32(const uint8_t *p) {
  return little_u24(p) | (uint32_t)p[3] << 24;
}

static bool read_png(const uint8_t *b, size_t size, struct lod_image *image) {
  if (size < 33 || memcmp(b, "\x89PNG\r\n\x1A\n", 8) != 0 || memcmp(b + 12, "IHDR", 4) != 0)
    return false;
  image->mime = "image/png";
  image->width = big_u32(b + 16);
  image->height = big_u32(b + 20);
  return true;
}

static bool read_jpeg(const uint8_t *b, size_t size, struct lod_image *image) {
  if (size < 4 || b[0] != 0xFF || b[1] != 0xD8)
    return false;
  size_t at = 2;
  while (at + 4 <= size) {
    if (b[at] != 0xFF)
      return false;
    uint8_t marker = b[at + 1];
    if (marker == 0xFF || marker == 0x01 || (marker >= 0xD0 && marker <= 0xD7)) {
      at += marker == 0xFF ? 1 : 2;
      continue;
    }
    size_t length = big_u16(b + at + 2);
    /* SOF0 ... SOF15 without DHT (C4), JPG (C8) and DAC (CC) */
    bool frame = marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
    if (frame) {
      if (at + 9 > size)
        return false;
      image->mime = "image/jpeg";
      image->height = big_u16(b + at + 5);
      image->width = big_u16(b + at + 7);
      return true;
    }
    if (length < 2 || marker == 0xD9 || marker == 0xDA)
      return false;
    at += 2 + length;
  }
  return false;
}

static bool read_webp(const uint8_t *b, size_t size, struct lod_image *image) {
  if (size < 30 || memcmp(b, "RIFF", 4) != 0 || memcmp(b + 8, "WEBP", 4) != 0)
    return false;
  image->mime = "image/webp";
  if (memcmp(b + 12, "VP8X", 4) == 0) {
    image->width = 1 + little_u24(b + 24);
    image->height = 1 + little_u24(b + 27);
  } else if (memcmp(b + 12, "VP8L", 4) == 0 && b[20] == 0x2F) {
    uint32_t bits = little_u32(b + 21);
    image->width = 1 + (bits & 0x3FFF);
    image->height = 1 + (bits >> 14 & 0x3FFF);
  } else if (memcmp(b + 12, "VP8 ", 4) == 0 && b[23] == 0x9D && b[24] == 0x01 && b[25] == 0x2A) {
    image->width = (little_u24(b + 26) & 0x3FFF);
    image->height = ((uint32_t)b[28] | (uint32_t)b[29] << 8) & 0x3FFF;
  } else {
    return false;
  }
  return true;
}

static bool read_ktx2(const uint8_t *b, size_t size, struct lod_image *image) {
  if (size < 80 || memcmp(b, "\xABKTX 20\xBB\r\n\x1A\n", 12) != 0)
    return false;
  image->mime = "image/ktx2";
  image->width = little_u32(b + 20);
  image->height = little_u32(b + 24);
  return true;
}

enum lod_status lod_reader_add_image(struct lod_reader *reader, const char *name, const uint8_t *bytes, size_t size, uint32_t *index) {
  struct lod_image image = {.name = name ? name : "", .bytes = bytes, .size = size};
  *index = LOD_NONE;
  if (size > reader->limits.max_texture_bytes)
    return lod_reader_fail(reader, LOD_LIMIT, "limit-texture-bytes", "texture '%.80s' has %zu bytes, the limit is %llu", image.name, size,
                           (unsigned long long)reader->limits.max_texture_bytes);
  bool known =
      read_png(bytes, size, &image) || read_jpeg(bytes, size, &image) || read_webp(bytes, size, &image) || read_ktx2(bytes, size, &image);
  if (!known || image.width == 0 || image.height == 0) {
    lod_scene_warn(reader->scene, "Texture '%.80s' is not a readable PNG, JPEG, WebP or KTX2 picture and was dropped.", image.name);
    return LOD_OK;
  }
  uint32_t limit = reader->limits.max_texture_pixels;
  if (image.width > limit || image.height > limit)
    return lod_reader_fail(reader, LOD_LIMIT, "limit-texture-pixels", "texture '%.80s' is %u x %u pixels, the limit is %u each way",
                           image.name, image.width, image.height, limit);
  *index = lod_scene_add_image(reader->scene, &image);
  return *index == LOD_NONE ? lod_reader_memory(reader) : LOD_OK;
}
