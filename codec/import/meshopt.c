/* EXT_meshopt_compression: attribute, triangle and index streams and the three filters.
 *
 * Based on: Khronos. EXT_meshopt_compression, appendices A (bitstream) and B (filters). The initial content of the FIFOs is undefined
 * there; here it is zero, so that any stream decodes to the same bytes everywhere. */
#include "codec/import/meshopt.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

enum { kGroup = 16, kMaxStride = 256, kMaxBlock = 256, kBlockBytes = 8192 };

struct input {
  const uint8_t *at, *end;
};

static size_t left(const struct input *input) {
  return (size_t)(input->end - input->at);
}

static enum lod_status fail(struct lod_problem *problem, const char *what) {
  return lod_fail(problem, LOD_BAD_INPUT, "bad-meshopt", "EXT_meshopt_compression: %s", what);
}

/* --- mode 0: attributes --- */

static uint8_t unzigzag(uint8_t v) {
  return (uint8_t)((v & 1) ? ~(v >> 1) : v >> 1);
}

/* 16 deltas in `bits` bits each (2 or 4), most significant first; all ones means that a whole byte follows behind the group. */
static bool read_sentinel_group(struct input *input, int bits, uint8_t deltas[kGroup]) {
  size_t packed = (size_t)(kGroup * bits / 8);
  if (left(input) < packed)
    return false;
  const uint8_t *codes = input->at;
  uint8_t mask = (uint8_t)((1 << bits) - 1);
  input->at += packed;
  for (int i = 0; i < kGroup; i++) {
    int shift = 8 - bits - i * bits % 8;
    uint8_t code = (uint8_t)(codes[i * bits / 8] >> shift & mask);
    if (code == mask) {
      if (left(input) < 1)
        return false;
      code = *input->at++;
    }
    deltas[i] = code;
  }
  return true;
}

static bool read_group(struct input *input, int encoding, uint8_t deltas[kGroup]) {
  switch (encoding) {
  case 0:
    memset(deltas, 0, kGroup);
    return true;
  case 1:
    return read_sentinel_group(input, 2, deltas);
  case 2:
    return read_sentinel_group(input, 4, deltas);
  default:
    if (left(input) < kGroup)
      return false;
    memcpy(deltas, input->at, kGroup);
    input->at += kGroup;
    return true;
  }
}

/* The byte at `offset` of every element of a block; `last` is that byte of the element before. */
static bool read_data_block(struct input *input, uint8_t *out, size_t elements, size_t stride, uint8_t *last) {
  size_t groups = (elements + kGroup - 1) / kGroup, header_size = (groups + 3) / 4;
  if (left(input) < header_size)
    return false;
  const uint8_t *header = input->at;
  input->at += header_size;
  for (size_t g = 0; g < groups; g++) {
    uint8_t deltas[kGroup];
    if (!read_group(input, header[g / 4] >> (g % 4 * 2) & 3, deltas))
      return false;
    size_t count = elements - g * kGroup < kGroup ? elements - g * kGroup : kGroup;
    for (size_t i = 0; i < count; i++) {
      *last = (uint8_t)(*last + unzigzag(deltas[i]));
      out[(g * kGroup + i) * stride] = *last;
    }
  }
  return true;
}

static enum lod_status decode_attributes(uint8_t *out, size_t count, size_t stride, const uint8_t *bytes, size_t size,
                                         struct lod_problem *problem) {
  size_t tail = stride < 32 ? 32 : stride;
  if (size < 1 + tail)
    return fail(problem, "an attribute stream is shorter than its header and tail");
  if (bytes[0] != 0xA0)
    return fail(problem, "an attribute stream does not start with 0xA0");
  struct input input = {bytes + 1, bytes + size - tail};
  uint8_t last[kMaxStride];
  memcpy(last, bytes + size - stride, stride);
  size_t most = kBlockBytes / stride & ~(size_t)(kGroup - 1);
  if (most > kMaxBlock)
    most = kMaxBlock;
  for (size_t done = 0; done < count;) {
    size_t elements = count - done < most ? count - done : most;
    for (size_t offset = 0; offset < stride; offset++)
      if (!read_data_block(&input, out + done * stride + offset, elements, stride, &last[offset]))
        return fail(problem, "an attribute stream ends too early");
    done += elements;
  }
  return left(&input) == 0 ? LOD_OK : fail(problem, "an attribute stream has bytes left over");
}

/* --- modes 1 and 2: indices --- */

/* LEB128 of at most 32 bits. */
static bool read_varint(struct input *input, uint32_t *value) {
  *value = 0;
  for (int shift = 0; shift < 35; shift += 7) {
    if (left(input) < 1)
      return false;
    uint8_t byte = *input->at++;
    *value |= (uint32_t)(byte & 0x7F) << shift;
    if (!(byte & 0x80))
      return true;
  }
  return false;
}

static uint32_t unzigzag32(uint32_t v) {
  return (v & 1) ? ~(v >> 1) : v >> 1;
}

static void store_index(uint8_t *out, size_t stride, uint32_t index) {
  out[0] = (uint8_t)index;
  out[1] = (uint8_t)(index >> 8);
  if (stride == 4) {
    out[2] = (uint8_t)(index >> 16);
    out[3] = (uint8_t)(index >> 24);
  }
}

static enum lod_status decode_indices(uint8_t *out, size_t count, size_t stride, const uint8_t *bytes, size_t size,
                                      struct lod_problem *problem) {
  const size_t tail = 4;
  if (size < 1 + tail)
    return fail(problem, "an index stream is shorter than its header and tail");
  if (bytes[0] != 0xD1)
    return fail(problem, "an index stream does not start with 0xD1");
  struct input input = {bytes + 1, bytes + size - tail};
  uint32_t last[2] = {0, 0};
  for (size_t i = 0; i < count; i++) {
    uint32_t v;
    if (!read_varint(&input, &v))
      return fail(problem, "an index stream ends too early");
    last[v & 1] += unzigzag32(v >> 1);
    if (stride == 2 && last[v & 1] > UINT16_MAX)
      return fail(problem, "an index does not fit into 16 bits");
    store_index(out + i * stride, stride, last[v & 1]);
  }
  return left(&input) == 0 ? LOD_OK : fail(problem, "an index stream has bytes left over");
}

struct triangles {
  struct input data;
  const uint8_t *table; /* codeaux */
  uint32_t next, last;
  uint32_t edges[16][2], vertices[16];
  unsigned edge_at, vertex_at; /* where the next one goes */
};

static void push_edge(struct triangles *t, uint32_t a, uint32_t b) {
  t->edges[t->edge_at][0] = a;
  t->edges[t->edge_at][1] = b;
  t->edge_at = (t->edge_at + 1) & 15;
}

static void push_vertex(struct triangles *t, uint32_t v) {
  t->vertices[t->vertex_at] = v;
  t->vertex_at = (t->vertex_at + 1) & 15;
}

/* 0 is the one pushed last. */
static uint32_t recent_vertex(const struct triangles *t, unsigned back) {
  return t->vertices[(t->vertex_at - 1 - back) & 15];
}

static bool read_explicit(struct triangles *t, uint32_t *index) {
  uint32_t v;
  if (!read_varint(&t->data, &v))
    return false;
  t->last += unzigzag32(v);
  *index = t->last;
  return true;
}

/* Codes 0x00 to 0xEF: an edge seen lately and a third vertex. */
static bool read_edge_triangle(struct triangles *t, uint8_t code, uint32_t triangle[3]) {
  unsigned x = code >> 4, y = code & 15;
  const uint32_t *edge = t->edges[(t->edge_at - 1 - x) & 15];
  uint32_t a = edge[0], b = edge[1], c;
  if (y == 0)
    c = t->next++;
  else if (y < 13)
    c = recent_vertex(t, y);
  else if (y == 13)
    c = --t->last;
  else if (y == 14)
    c = ++t->last;
  else if (!read_explicit(t, &c))
    return false;
  push_edge(t, c, b);
  push_edge(t, a, c);
  if (y == 0 || y >= 13)
    push_vertex(t, c);
  triangle[0] = a;
  triangle[1] = b;
  triangle[2] = c;
  return true;
}

/* The second and third vertex of a free-standing triangle. */
static bool read_corner(struct triangles *t, unsigned nibble, uint32_t *index) {
  if (nibble == 0)
    *index = t->next++;
  else if (nibble < 15)
    *index = recent_vertex(t, nibble - 1);
  else
    return read_explicit(t, index);
  return true;
}

/* Codes 0xF0 to 0xFF: three vertices, of which each may be new, seen lately or written out. */
static bool read_free_triangle(struct triangles *t, uint8_t code, uint32_t triangle[3]) {
  uint8_t nibbles;
  if (code < 0xFE) {
    nibbles = t->table[code & 15];
  } else {
    if (left(&t->data) < 1)
      return false;
    nibbles = *t->data.at++;
    if (nibbles == 0)
      t->next = 0;
  }
  unsigned z = nibbles >> 4, w = nibbles & 15;
  if (code != 0xFF)
    triangle[0] = t->next++;
  else if (!read_explicit(t, &triangle[0]))
    return false;
  if (!read_corner(t, z, &triangle[1]) || !read_corner(t, w, &triangle[2]))
    return false;
  push_edge(t, triangle[1], triangle[0]);
  push_edge(t, triangle[2], triangle[1]);
  push_edge(t, triangle[0], triangle[2]);
  push_vertex(t, triangle[0]);
  if (z == 0 || z == 15)
    push_vertex(t, triangle[1]);
  if (w == 0 || w == 15)
    push_vertex(t, triangle[2]);
  return true;
}

static enum lod_status decode_triangles(uint8_t *out, size_t count, size_t stride, const uint8_t *bytes, size_t size,
                                        struct lod_problem *problem) {
  const size_t tail = 16, codes = count / 3;
  if (size < 1 + tail || size - 1 - tail < codes)
    return fail(problem, "a triangle stream is shorter than its header, codes and tail");
  if (bytes[0] != 0xE1)
    return fail(problem, "a triangle stream does not start with 0xE1");
  struct triangles t = {.data = {bytes + 1 + codes, bytes + size - tail}, .table = bytes + size - tail};
  if (t.table[14] != 0 || t.table[15] != 0)
    return fail(problem, "a triangle stream has a bad table");
  for (int i = 0; i < 14; i++)
    if ((t.table[i] >> 4) == 15 || (t.table[i] & 15) == 15)
      return fail(problem, "a triangle stream has a bad table");
  for (size_t i = 0; i < codes; i++) {
    uint8_t code = bytes[1 + i];
    uint32_t triangle[3];
    bool ok = code < 0xF0 ? read_edge_triangle(&t, code, triangle) : read_free_triangle(&t, code, triangle);
    if (!ok)
      return fail(problem, "a triangle stream ends too early");
    for (size_t k = 0; k < 3; k++) {
      if (stride == 2 && triangle[k] > UINT16_MAX)
        return fail(problem, "an index does not fit into 16 bits");
      store_index(out + (3 * i + k) * stride, stride, triangle[k]);
    }
  }
  return left(&t.data) == 0 ? LOD_OK : fail(problem, "a triangle stream has bytes left over");
}

/* --- filters --- */

static int16_t load16(const uint8_t *p) {
  return (int16_t)(p[0] | p[1] << 8);
}

static void store16(uint8_t *p, int32_t value) {
  p[0] = (uint8_t)value;
  p[1] = (uint8_t)((uint32_t)value >> 8);
}

/* Rounds to the nearest integer, clamped to +-most; what is not a number becomes 0. */
static int32_t to_normalized(float value, int32_t most) {
  float scaled = value * (float)most;
  if (!(scaled > (float)-most))
    return isnan(scaled) ? 0 : -most;
  return scaled < (float)most ? (int32_t)roundf(scaled) : most;
}

static void filter_octahedral(uint8_t *out, size_t count, size_t stride) {
  int32_t most = stride == 4 ? 127 : 32767;
  for (size_t i = 0; i < count; i++, out += stride) {
    int32_t in[3];
    for (int k = 0; k < 3; k++)
      in[k] = stride == 4 ? (int8_t)out[k] : load16(out + 2 * k);
    float one = (float)in[2], x = (float)in[0] / one, y = (float)in[1] / one, z = 1 - fabsf(x) - fabsf(y);
    float t = z < 0 ? z : 0;
    x -= copysignf(t, x);
    y -= copysignf(t, y);
    float length = sqrtf(x * x + y * y + z * z), v[3] = {x / length, y / length, z / length};
    for (int k = 0; k < 3; k++)
      if (stride == 4)
        out[k] = (uint8_t)to_normalized(v[k], most);
      else
        store16(out + 2 * k, to_normalized(v[k], most));
  }
}

static void filter_quaternion(uint8_t *out, size_t count) {
  const float range = 0.70710678f;
  for (size_t i = 0; i < count; i++, out += 8) {
    int32_t last = load16(out + 6), largest = last & 3;
    float one = (float)(last | 3), v[3], rest = 1;
    for (int k = 0; k < 3; k++) {
      v[k] = (float)load16(out + 2 * k) / one * range;
      rest -= v[k] * v[k];
    }
    for (int k = 0; k < 3; k++)
      store16(out + 2 * ((largest + 1 + k) & 3), to_normalized(v[k], 32767));
    store16(out + 2 * largest, to_normalized(sqrtf(rest > 0 ? rest : 0), 32767));
  }
}

static void filter_exponential(uint8_t *out, size_t words) {
  for (size_t i = 0; i < words; i++, out += 4) {
    uint32_t bits = (uint32_t)out[0] | (uint32_t)out[1] << 8 | (uint32_t)out[2] << 16;
    int32_t mantissa = (int32_t)bits - ((bits & 0x800000) ? 0x1000000 : 0);
    float value = ldexpf((float)mantissa, (int8_t)out[3]);
    memcpy(&bits, &value, sizeof bits);
    for (int k = 0; k < 4; k++)
      out[k] = (uint8_t)(bits >> 8 * k);
  }
}

/* --- entrance --- */

static enum lod_status check_arguments(enum lod_meshopt_mode mode, enum lod_meshopt_filter filter, size_t count, size_t stride,
                                       struct lod_problem *problem) {
  if (mode == LOD_MESHOPT_ATTRIBUTES) {
    if (stride == 0 || stride > kMaxStride || stride % 4 != 0)
      return fail(problem, "the stride of attributes is no multiple of 4 up to 256");
    if (filter == LOD_MESHOPT_OCTAHEDRAL && stride != 4 && stride != 8)
      return fail(problem, "the octahedral filter needs a stride of 4 or 8");
    if (filter == LOD_MESHOPT_QUATERNION && stride != 8)
      return fail(problem, "the quaternion filter needs a stride of 8");
    return LOD_OK;
  }
  if (stride != 2 && stride != 4)
    return fail(problem, "the stride of indices is neither 2 nor 4");
  if (filter != LOD_MESHOPT_NONE)
    return fail(problem, "indices have no filter");
  if (mode == LOD_MESHOPT_TRIANGLES && count % 3 != 0)
    return fail(problem, "the count of triangle indices is no multiple of 3");
  return LOD_OK;
}

enum lod_status lod_meshopt_decode(enum lod_meshopt_mode mode, enum lod_meshopt_filter filter, uint8_t *out, size_t count, size_t stride,
                                   const uint8_t *bytes, size_t size, struct lod_problem *problem) {
  LOD_TRY(check_arguments(mode, filter, count, stride, problem));
  if (mode == LOD_MESHOPT_TRIANGLES)
    return decode_triangles(out, count, stride, bytes, size, problem);
  if (mode == LOD_MESHOPT_INDICES)
    return decode_indices(out, count, stride, bytes, size, problem);
  LOD_TRY(decode_attributes(out, count, stride, bytes, size, problem));
  if (filter == LOD_MESHOPT_OCTAHEDRAL)
    filter_octahedral(out, count, stride);
  else if (filter == LOD_MESHOPT_QUATERNION)
    filter_quaternion(out, count);
  else if (filter == LOD_MESHOPT_EXPONENTIAL)
    filter_exponential(out, count * (stride / 4));
  return LOD_OK;
}
