/* Bytes of buffers and buffer views, and the values that accessors find in them.
 *
 * Based on: Khronos. glTF 2.0 Specification, 3.6; EXT_meshopt_compression; KHR_mesh_quantization. Every length is checked here, before it
 * is used: structure that came through the schema check has indices in range, and nothing else. */
#include <math.h>
#include <string.h>

#include "codec/import/gltf_document.h"
#include "codec/import/meshopt.h"

/* --- buffers and views --- */

static enum lod_status buffer_bytes(struct lod_gltf_document *document, uint32_t index, const uint8_t **bytes, size_t *size) {
  struct lod_gltf_bytes *buffer = &document->buffers[index];
  struct lod_reader *reader = document->reader;
  if (!buffer->loaded) {
    const json_t *object = lod_gltf_object(document, "buffers", index);
    const char *uri = json_string_value(json_object_get(object, "uri"));
    uint64_t length = (uint64_t)json_number_value(json_object_get(object, "byteLength"));
    if (uri) {
      LOD_TRY(lod_reader_open_uri(reader, uri, reader->scratch, &buffer->bytes, &buffer->size));
    } else if (index == 0 && document->binary) {
      buffer->bytes = document->binary;
      buffer->size = document->binary_size;
    } else {
      return lod_reader_bad(reader, "missing-file", "buffers[%u] has neither a uri nor a BIN chunk", index);
    }
    if (length > buffer->size)
      return lod_reader_bad(reader, "truncated", "buffers[%u] says it has %llu bytes, but there are %zu", index, (unsigned long long)length,
                            buffer->size);
    buffer->size = (size_t)length;
    buffer->loaded = true;
  }
  *bytes = buffer->bytes;
  *size = buffer->size;
  return LOD_OK;
}

static enum lod_status buffer_range(struct lod_gltf_document *document, uint32_t view, uint32_t buffer, uint64_t offset, uint64_t length,
                                    const uint8_t **bytes) {
  size_t size = 0;
  LOD_TRY(buffer_bytes(document, buffer, bytes, &size));
  if (offset > size || length > size - offset)
    return lod_reader_bad(document->reader, "truncated", "bufferViews[%u] needs bytes %llu to %llu of a buffer that has %zu", view,
                          (unsigned long long)offset, (unsigned long long)(offset + length), size);
  *bytes += offset;
  return LOD_OK;
}

static bool find_name(const char *name, const char *const *names, int count, int *index) {
  for (*index = 0; *index < count; ++*index)
    if (name && strcmp(name, names[*index]) == 0)
      return true;
  return false;
}

static enum lod_status decompress(struct lod_gltf_document *document, uint32_t view, const json_t *extension, struct lod_gltf_bytes *out) {
  static const char *const kModes[] = {"ATTRIBUTES", "TRIANGLES", "INDICES"};
  static const char *const kFilters[] = {"NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL"};
  static const char *const kNumbers[] = {"byteOffset", "byteLength", "byteStride", "count"};
  struct lod_reader *reader = document->reader;
  uint64_t numbers[4] = {0};
  int32_t buffer;
  int mode, filter = 0;
  LOD_TRY(lod_gltf_index(document, extension, "EXT_meshopt_compression", "buffer", document->buffer_count, &buffer));
  for (int i = 0; i < 4; i++) {
    const json_t *value = json_object_get(extension, kNumbers[i]);
    json_int_t number = json_integer_value(value);
    if ((value && (!json_is_integer(value) || number < 0)) || (!value && i > 0))
      return lod_reader_bad(reader, "bad-json", "EXT_meshopt_compression.%s of bufferViews[%u] is no whole number", kNumbers[i], view);
    numbers[i] = (uint64_t)number;
  }
  const json_t *filter_name = json_object_get(extension, "filter");
  if (buffer < 0 || !find_name(json_string_value(json_object_get(extension, "mode")), kModes, 3, &mode) ||
      (filter_name && !find_name(json_string_value(filter_name), kFilters, 4, &filter)))
    return lod_reader_bad(reader, "bad-json", "EXT_meshopt_compression of bufferViews[%u] lacks a buffer or has an unknown mode or filter",
                          view);
  uint64_t length = document->gltf.views[view].length, stride = numbers[2], count = numbers[3];
  if (stride == 0 || stride > 256 || length / stride < count || length != stride * count)
    return lod_reader_bad(reader, "bad-meshopt", "bufferViews[%u].byteLength is not EXT_meshopt_compression's byteStride times count",
                          view);
  /* At best 16 bytes come from 2 bits (a group whose deltas are all 0): nothing unpacks to more than 64 times its size. */
  if (length / 128 > numbers[1])
    return lod_reader_bad(reader, "truncated", "bufferViews[%u] cannot unpack to %llu bytes from %llu", view, (unsigned long long)length,
                          (unsigned long long)numbers[1]);
  const uint8_t *packed;
  LOD_TRY(buffer_range(document, view, (uint32_t)buffer, numbers[0], numbers[1], &packed));
  uint8_t *bytes = lod_arena_alloc(reader->scratch, length, 1);
  if (!bytes)
    return lod_reader_memory(reader);
  struct lod_problem problem = {0};
  enum lod_status status =
      lod_meshopt_decode((enum lod_meshopt_mode)mode, (enum lod_meshopt_filter)filter, bytes, count, stride, packed, numbers[1], &problem);
  if (status != LOD_OK)
    return lod_reader_fail(reader, status, problem.type, "bufferViews[%u]: %s", view, problem.detail);
  *out = (struct lod_gltf_bytes){.bytes = bytes, .size = length};
  return LOD_OK;
}

enum lod_status lod_gltf_view_bytes(struct lod_gltf_document *document, uint32_t view, const uint8_t **bytes, size_t *size) {
  struct lod_gltf_bytes *cached = &document->views[view];
  const struct lod_gltf_view *source = &document->gltf.views[view];
  if (!cached->loaded) {
    const json_t *extension = lod_gltf_extension(lod_gltf_object(document, "bufferViews", view), "EXT_meshopt_compression");
    if (extension) {
      LOD_TRY(decompress(document, view, extension, cached));
    } else {
      LOD_TRY(buffer_range(document, view, (uint32_t)source->buffer, source->offset, source->length, &cached->bytes));
      cached->size = source->length;
    }
    cached->loaded = true;
  }
  *bytes = cached->bytes;
  *size = cached->size;
  return LOD_OK;
}

/* --- accessors --- */

static size_t component_size(int32_t component) {
  switch (component) {
  case LOD_GLTF_BYTE:
  case LOD_GLTF_UBYTE:
    return 1;
  case LOD_GLTF_SHORT:
  case LOD_GLTF_USHORT:
    return 2;
  case LOD_GLTF_UINT:
  case LOD_GLTF_FLOAT:
    return 4;
  default:
    return 0;
  }
}

struct elements {
  const uint8_t *bytes; /* NULL = all zero */
  size_t stride;
};

/* Matrices' columns start at multiples of four bytes (3.6.2.4): only 2x2 and 3x3 of small types have gaps, and none of those is used here.
 */
static enum lod_status find_elements(struct lod_gltf_document *document, uint32_t index, int32_t view, uint64_t offset, uint64_t count,
                                     size_t element, bool packed, struct elements *out) {
  const uint8_t *bytes = NULL;
  size_t size = 0;
  LOD_TRY(lod_gltf_view_bytes(document, (uint32_t)view, &bytes, &size));
  uint64_t stride = packed ? 0 : document->gltf.views[view].stride;
  stride = stride ? stride : element;
  if (stride < element)
    return lod_reader_bad(document->reader, "bad-accessor", "accessors[%u] has elements of %zu bytes in a view with a stride of %llu",
                          index, element, (unsigned long long)stride);
  if (count > 0 && (offset > size || size - offset < element || (count - 1) > (size - offset - element) / stride))
    return lod_reader_bad(document->reader, "truncated", "accessors[%u] needs %llu elements, more than bufferViews[%d] holds", index,
                          (unsigned long long)count, view);
  *out = (struct elements){bytes + offset, stride};
  return LOD_OK;
}

static double load(const uint8_t *p, int32_t component) {
  uint16_t half = component_size(component) >= 2 ? (uint16_t)(p[0] | p[1] << 8) : 0;
  uint32_t word = component_size(component) == 4 ? half | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24 : 0;
  float value;
  switch (component) {
  case LOD_GLTF_BYTE:
    return (int8_t)p[0];
  case LOD_GLTF_UBYTE:
    return p[0];
  case LOD_GLTF_SHORT:
    return (int16_t)half;
  case LOD_GLTF_USHORT:
    return half;
  case LOD_GLTF_UINT:
    return word;
  default:
    memcpy(&value, &word, sizeof value);
    return (double)value;
  }
}

/* 3.6.2.2, and KHR_mesh_quantization: the most negative integer is -1 like the one above it. */
static float to_float(double value, int32_t component, bool normalized) {
  if (!normalized)
    return (float)value;
  switch (component) {
  case LOD_GLTF_BYTE:
    return (float)fmax(value / 127, -1);
  case LOD_GLTF_UBYTE:
    return (float)(value / 255);
  case LOD_GLTF_SHORT:
    return (float)fmax(value / 32767, -1);
  case LOD_GLTF_USHORT:
    return (float)(value / 65535);
  default:
    return (float)value;
  }
}

/* Calls for every element that `from` holds: element number i of the output gets the i-th (or the indices' i-th) one. */
static void copy_floats(const struct lod_gltf_accessor *accessor, const struct elements *from, bool normalized, float *out) {
  size_t size = component_size(accessor->component), n = (size_t)accessor->components;
  if (accessor->component == LOD_GLTF_FLOAT && from->stride == 4 * n) {
    for (uint64_t i = 0; i < accessor->count * n; i++)
      out[i] = (float)load(from->bytes + 4 * i, LOD_GLTF_FLOAT);
    return;
  }
  for (uint64_t i = 0; i < accessor->count; i++)
    for (size_t k = 0; k < n; k++)
      out[i * n + k] = to_float(load(from->bytes + i * from->stride + k * size, accessor->component), accessor->component, normalized);
}

static enum lod_status apply_sparse(struct lod_gltf_document *document, uint32_t index, const struct lod_gltf_accessor *accessor,
                                    bool normalized, float *out) {
  struct elements indices, values;
  size_t size = component_size(accessor->component), n = (size_t)accessor->components;
  int32_t type = accessor->sparse_index_component;
  if (accessor->sparse_count > accessor->count || (type != LOD_GLTF_UBYTE && type != LOD_GLTF_USHORT && type != LOD_GLTF_UINT))
    return lod_reader_bad(document->reader, "bad-accessor",
                          "accessors[%u].sparse has more elements than the accessor, or indices of a wrong type", index);
  LOD_TRY(find_elements(document, index, accessor->sparse_index_view, accessor->sparse_index_offset, accessor->sparse_count,
                        component_size(type), true, &indices));
  LOD_TRY(find_elements(document, index, accessor->sparse_value_view, accessor->sparse_value_offset, accessor->sparse_count, size * n, true,
                        &values));
  for (uint64_t i = 0; i < accessor->sparse_count; i++) {
    uint64_t at = (uint64_t)load(indices.bytes + i * indices.stride, type);
    if (at >= accessor->count)
      return lod_reader_bad(document->reader, "index-out-of-range", "accessors[%u].sparse replaces element %llu of %llu", index,
                            (unsigned long long)at, (unsigned long long)accessor->count);
    for (size_t k = 0; k < n; k++)
      out[at * n + k] = to_float(load(values.bytes + i * values.stride + k * size, accessor->component), accessor->component, normalized);
  }
  return LOD_OK;
}

static enum lod_status check_type(struct lod_gltf_document *document, uint32_t index, int components, bool integers) {
  const struct lod_gltf_accessor *accessor = &document->gltf.accessors[index];
  int32_t type = accessor->component;
  bool unsigned_integer = type == LOD_GLTF_UBYTE || type == LOD_GLTF_USHORT || type == LOD_GLTF_UINT;
  bool square = components == 16;
  if (accessor->components != components || accessor->matrix != square || component_size(type) == 0 || (integers && !unsigned_integer))
    return lod_reader_bad(document->reader, "bad-accessor", "accessors[%u] has a type that does not fit what it is used for", index);
  return LOD_OK;
}

enum lod_status lod_gltf_check_fits(struct lod_gltf_document *document, uint32_t index) {
  const struct lod_gltf_accessor *accessor = &document->gltf.accessors[index];
  struct elements from;
  size_t element = component_size(accessor->component) * (size_t)accessor->components;
  if (accessor->view < 0 || element == 0)
    return LOD_OK;
  return find_elements(document, index, accessor->view, accessor->offset, accessor->count, element, false, &from);
}

enum lod_status lod_gltf_read_floats(struct lod_gltf_document *document, uint32_t index, int components, bool as_normalized,
                                     float **values) {
  const struct lod_gltf_accessor *accessor = &document->gltf.accessors[index];
  struct lod_reader *reader = document->reader;
  struct elements from = {0};
  LOD_TRY(check_type(document, index, components, false));
  size_t element = component_size(accessor->component) * (size_t)components;
  if (accessor->view >= 0)
    LOD_TRY(find_elements(document, index, accessor->view, accessor->offset, accessor->count, element, false, &from));
  *values = lod_arena_calloc(reader->scratch, accessor->count, sizeof(float) * (size_t)components);
  if (!*values)
    return lod_reader_memory(reader);
  bool normalized = accessor->normalized || as_normalized;
  if (from.bytes)
    copy_floats(accessor, &from, normalized, *values);
  return accessor->sparse_count > 0 ? apply_sparse(document, index, accessor, normalized, *values) : LOD_OK;
}

static enum lod_status apply_sparse_integers(struct lod_gltf_document *document, uint32_t index, const struct lod_gltf_accessor *accessor,
                                             uint32_t *out) {
  float *replaced;
  /* Sparse indices or joints are rare and small; the float path is exact to 2^24, beyond that they are refused. */
  LOD_TRY(lod_gltf_read_floats(document, index, accessor->components, false, &replaced));
  for (uint64_t i = 0; i < accessor->count * (uint64_t)accessor->components; i++) {
    if (replaced[i] >= 0x1p24f)
      return lod_reader_fail(document->reader, LOD_UNSUPPORTED, "bad-accessor", "accessors[%u] is sparse and holds indices above 2^24",
                             index);
    out[i] = (uint32_t)replaced[i];
  }
  return LOD_OK;
}

enum lod_status lod_gltf_read_integers(struct lod_gltf_document *document, uint32_t index, int components, uint32_t **values) {
  const struct lod_gltf_accessor *accessor = &document->gltf.accessors[index];
  struct lod_reader *reader = document->reader;
  struct elements from = {0};
  LOD_TRY(check_type(document, index, components, true));
  size_t size = component_size(accessor->component), n = (size_t)components;
  if (accessor->view >= 0)
    LOD_TRY(find_elements(document, index, accessor->view, accessor->offset, accessor->count, size * n, false, &from));
  *values = lod_arena_calloc(reader->scratch, accessor->count, sizeof(uint32_t) * n);
  if (!*values)
    return lod_reader_memory(reader);
  if (accessor->sparse_count > 0)
    return apply_sparse_integers(document, index, accessor, *values);
  for (uint64_t i = 0; from.bytes && i < accessor->count; i++)
    for (size_t k = 0; k < n; k++)
      (*values)[i * n + k] = (uint32_t)load(from.bytes + i * from.stride + k * size, accessor->component);
  return LOD_OK;
}
