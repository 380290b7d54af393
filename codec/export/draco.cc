/* The only file that sees Draco. Every entry: check, one guard, Draco, plain arrays out. */
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <limits>
#include <memory>
#include <new>
#include <stdexcept>

#include <draco/compression/decode.h>
#include <draco/compression/expert_encode.h>
#include <draco/mesh/mesh.h>

extern "C" {
#include "codec/export/draco.h"
}

static_assert(LOD_DRACO_POSITION == static_cast<int>(draco::GeometryAttribute::POSITION), "Draco's numbering");
static_assert(LOD_DRACO_NORMAL == static_cast<int>(draco::GeometryAttribute::NORMAL), "Draco's numbering");
static_assert(LOD_DRACO_COLOR == static_cast<int>(draco::GeometryAttribute::COLOR), "Draco's numbering");
static_assert(LOD_DRACO_TEXCOORD == static_cast<int>(draco::GeometryAttribute::TEX_COORD), "Draco's numbering");
static_assert(LOD_DRACO_GENERIC == static_cast<int>(draco::GeometryAttribute::GENERIC), "Draco's numbering");

namespace {

/* Runs `call` so that no exception leaves this file. */
template <typename Call> enum lod_status guarded(struct lod_problem *problem, Call call) {
  try {
    return call();
  } catch (const std::bad_alloc &) {
    return lod_fail_memory(problem);
  } catch (const std::length_error &) { /* a vector asked for more than the address space */
    return lod_fail_memory(problem);
  } catch (...) {
    return lod_fail(problem, LOD_BAD_INPUT, "draco", "Draco gave up on the mesh with an exception");
  }
}

} // namespace

/* ---- the grid ---- */

namespace {

/* Whether whole multiples of `unit` reach over the box with 24 bits. Origins are rounded down to multiples; the range that Draco is told
 * is step * (2^bits - 1), which is less than twice the longest side. */
bool unit_fits(const float *min, const float *max, int axes, double unit, double *side, float *origin) {
  double reach = 0;
  *side = 0;
  for (int i = 0; i < axes; i++) {
    const double low = std::floor((double)min[i] / unit) * unit;
    const double high = std::ceil((double)max[i] / unit) * unit;
    reach = std::fmax(reach, std::fmax(std::fabs(low), std::fabs(high)));
    *side = std::fmax(*side, high - low);
    origin[i] = (float)low;
  }
  /* The last index may lie half a step, at most half a side, beyond the box. */
  return std::fmax(reach + *side / 2, 2 * *side) <= std::ldexp(unit, 24);
}

/* Bits for indices up to the nearest to `side`. */
int bits_for(double side, double step) {
  const double last = std::floor(side / step + 0.5);
  int bits = 1;
  while (std::ldexp(1.0, bits) - 1 < last)
    bits++;
  return bits;
}

} // namespace

extern "C" struct lod_draco_grid lod_draco_grid_make(const float *min, const float *max, int axes, double step) {
  struct lod_draco_grid grid = {};
  double reach = 0, side = 0;
  for (int i = 0; i < axes; i++)
    reach = std::fmax(reach, std::fmax(std::fabs((double)min[i]), std::fabs((double)max[i])));
  int exponent = 0;
  std::frexp(reach, &exponent);
  exponent = reach == 0 || exponent < -100 ? -124 : exponent - 26; /* products below the normal floats would lose bits */
  double unit = std::ldexp(1.0, exponent);
  while (!unit_fits(min, max, axes, unit, &side, grid.origin))
    unit *= 2;
  /* Units in a step. A step longer than the box is no use. */
  double count = std::fmax(std::floor(std::fmin(step, side) / unit), 1);
  /* A whole number of steps along the longest side, as far as U allows: both its ends are then grid points and the box does not shrink. */
  count = std::fmax(std::floor(side / unit / std::ceil(side / unit / count)), 1);
  /* From 22 bits on Draco's float product value * (1 / step) is only sure to round to the right index when step is a power of two. */
  if (bits_for(side, count * unit) >= 22) {
    int power = 0;
    std::frexp(count, &power);
    count = std::ldexp(1.0, power - 1);
  }
  grid.step = (float)(count * unit);
  grid.bits = bits_for(side, (double)grid.step);
  return grid;
}

extern "C" int32_t lod_draco_grid_index(const struct lod_draco_grid *grid, int axis, float value) {
  const double q = std::floor(((double)value - (double)grid->origin[axis]) / (double)grid->step + 0.5);
  const double last = std::ldexp(1.0, grid->bits) - 1;
  return (int32_t)std::fmin(std::fmax(q, 0), last);
}

extern "C" float lod_draco_grid_point(const struct lod_draco_grid *grid, int axis, int32_t q) {
  const float offset = (float)q * grid->step;
  return offset + grid->origin[axis];
}

/* ---- components ---- */

extern "C" size_t lod_draco_component_size(enum lod_draco_component component) {
  switch (component) {
  case LOD_DRACO_INT8:
  case LOD_DRACO_UINT8:
    return 1;
  case LOD_DRACO_INT16:
  case LOD_DRACO_UINT16:
    return 2;
  case LOD_DRACO_INT32:
  case LOD_DRACO_UINT32:
  case LOD_DRACO_FLOAT:
    return 4;
  }
  return 0;
}

namespace {

draco::DataType data_type_of(enum lod_draco_component component) {
  switch (component) {
  case LOD_DRACO_INT8:
    return draco::DT_INT8;
  case LOD_DRACO_UINT8:
    return draco::DT_UINT8;
  case LOD_DRACO_INT16:
    return draco::DT_INT16;
  case LOD_DRACO_UINT16:
    return draco::DT_UINT16;
  case LOD_DRACO_INT32:
    return draco::DT_INT32;
  case LOD_DRACO_UINT32:
    return draco::DT_UINT32;
  case LOD_DRACO_FLOAT:
    break;
  }
  return draco::DT_FLOAT32;
}

/* ---- encode ---- */

draco::PointAttribute *add_attribute(draco::Mesh &mesh, enum lod_draco_kind kind, enum lod_draco_component component, int components,
                                     uint32_t unique_id, uint32_t value_count, int *id) {
  const draco::DataType type = data_type_of(component);
  draco::GeometryAttribute attribute;
  attribute.Init(static_cast<draco::GeometryAttribute::Type>(kind), nullptr, static_cast<uint8_t>(components), type,
                 kind == LOD_DRACO_COLOR, static_cast<int64_t>(draco::DataTypeLength(type)) * components, 0);
  *id = mesh.AddAttribute(attribute, false, value_count);
  draco::PointAttribute *added = mesh.attribute(*id);
  added->set_unique_id(unique_id);
  return added;
}

/* What ExpertEncoder::SetAttributeExplicitQuantization does, but without its loss: that one stores floats as text with six decimals, which
 * turns a range of 0.0001234567 into 0.000123. Hexadecimal text is exact, and strtof and atof read it. */
void set_grid(draco::ExpertEncoder &encoder, int id, const struct lod_draco_grid &grid, int components) {
  draco::Options options;
  char text[128];
  options.SetInt("quantization_bits", grid.bits);
  std::snprintf(text, sizeof text, "%a %a %a", (double)grid.origin[0], (double)grid.origin[1],
                components > 2 ? (double)grid.origin[2] : 0.0);
  options.SetString("quantization_origin", text);
  /* Exact in float: see lod_draco_grid_make. */
  const float range = static_cast<float>(std::ldexp(1.0, grid.bits) - 1) * grid.step;
  std::snprintf(text, sizeof text, "%a", (double)range);
  options.SetString("quantization_range", text);
  encoder.options().SetAttributeOptions(id, options);
}

void add_positions(const struct lod_draco_encode_request &request, draco::Mesh &mesh, draco::ExpertEncoder &encoder) {
  int id = 0;
  draco::PointAttribute *attribute = add_attribute(mesh, LOD_DRACO_POSITION, LOD_DRACO_FLOAT, 3, 0, request.vertex_count, &id);
  float *out = reinterpret_cast<float *>(attribute->buffer()->data());
  for (uint32_t v = 0; v < request.vertex_count; v++)
    for (int axis = 0; axis < 3; axis++)
      out[3 * static_cast<size_t>(v) + axis] = lod_draco_grid_point(&request.grid, axis, request.positions[v][axis]);
  for (uint32_t p = 0; p < request.point_count; p++)
    attribute->SetPointMapEntry(draco::PointIndex(p),
                                draco::AttributeValueIndex(request.point_vertices != nullptr ? request.point_vertices[p] : p));
  set_grid(encoder, id, request.grid, 3);
}

void add_input(const struct lod_draco_encode_request &request, const struct lod_draco_input &input, draco::Mesh &mesh,
               draco::ExpertEncoder &encoder) {
  int id = 0;
  draco::PointAttribute *attribute =
      add_attribute(mesh, input.kind, input.component, input.components, input.unique_id, input.value_count, &id);
  const size_t bytes = static_cast<size_t>(input.value_count) * input.components * lod_draco_component_size(input.component);
  std::memcpy(attribute->buffer()->data(), input.values, bytes);
  for (uint32_t p = 0; p < request.point_count; p++)
    attribute->SetPointMapEntry(draco::PointIndex(p), draco::AttributeValueIndex(input.point_values[p]));
  if (input.component != LOD_DRACO_FLOAT)
    return;
  if (input.kind == LOD_DRACO_NORMAL) {
    encoder.SetAttributeQuantization(id, input.bits);
  } else {
    set_grid(encoder, id, input.grid, input.components);
  }
}

enum lod_status encode(const struct lod_draco_encode_request &request, struct lod_arena *arena, uint8_t **bytes, size_t *size,
                       uint32_t *points, uint32_t *triangles, struct lod_problem *problem) {
  draco::Mesh mesh;
  mesh.set_num_points(request.point_count);
  mesh.SetNumFaces(request.triangle_count);
  for (uint32_t t = 0; t < request.triangle_count; t++) {
    const uint32_t *corner = request.triangles[t];
    mesh.SetFace(draco::FaceIndex(t), {{draco::PointIndex(corner[0]), draco::PointIndex(corner[1]), draco::PointIndex(corner[2])}});
  }
  draco::ExpertEncoder encoder(mesh);
  add_positions(request, mesh, encoder);
  for (uint32_t i = 0; i < request.input_count; i++)
    add_input(request, request.inputs[i], mesh, encoder);
  encoder.SetSpeedOptions(request.speed, request.speed);
  encoder.SetEncodingMethod(request.sequential ? draco::MESH_SEQUENTIAL_ENCODING : draco::MESH_EDGEBREAKER_ENCODING);
  encoder.SetTrackEncodedProperties(true);
  draco::EncoderBuffer buffer;
  const draco::Status status = encoder.EncodeToBuffer(&buffer);
  if (!status.ok())
    return lod_fail(problem, LOD_BAD_INPUT, "draco", "Draco cannot encode a mesh of %u triangles: %s", request.triangle_count,
                    status.error_msg());
  *size = buffer.size();
  *points = static_cast<uint32_t>(encoder.num_encoded_points());
  *triangles = static_cast<uint32_t>(encoder.num_encoded_faces());
  *bytes = static_cast<uint8_t *>(lod_arena_copy(arena, buffer.data(), buffer.size()));
  return *bytes == nullptr ? lod_fail_memory(problem) : LOD_OK;
}

} // namespace

extern "C" enum lod_status lod_draco_encode(const struct lod_draco_encode_request *request, struct lod_arena *arena, uint8_t **bytes,
                                            size_t *size, uint32_t *points, uint32_t *triangles, struct lod_problem *problem) {
  /* Draco counts corners in 32 signed bits. */
  if (request->triangle_count > INT32_MAX / 3)
    return lod_fail(problem, LOD_LIMIT, "limit-triangles", "A mesh of %u triangles is more than Draco can encode (%d)",
                    request->triangle_count, INT32_MAX / 3);
  return guarded(problem, [&] { return encode(*request, arena, bytes, size, points, triangles, problem); });
}

/* ---- header ---- */

namespace {

struct reader {
  const uint8_t *at, *end;
  bool failed;

  uint32_t fixed(int width) {
    uint32_t value = 0;
    if (end - at < width) {
      failed = true;
      return 0;
    }
    for (int i = 0; i < width; i++)
      value |= static_cast<uint32_t>(*at++) << (8 * i);
    return value;
  }
  uint32_t varint() {
    uint32_t value = 0;
    for (int shift = 0; shift < 35; shift += 7) {
      const uint32_t byte = fixed(1);
      value |= (byte & 127) << shift;
      if (failed || byte < 128)
        return value;
    }
    failed = true;
    return 0;
  }
  void skip(uint32_t count) {
    if (static_cast<uint64_t>(end - at) < count)
      failed = true;
    else
      at += count;
  }
};

enum { METADATA_FLAG = 0x8000, METADATA_DEPTH = 64 };

/* One metadata tree: entries (name, blob), then children by name. Iterative, so that nesting cannot eat the stack. */
void skip_metadata_tree(reader &in) {
  uint32_t children[METADATA_DEPTH];
  int depth = 0;
  for (;;) {
    for (uint32_t entries = in.varint(); entries > 0 && !in.failed; entries--) {
      in.skip(in.fixed(1));
      in.skip(in.varint());
    }
    children[depth] = in.varint();
    while (!in.failed && children[depth] == 0)
      if (depth-- == 0)
        return;
    if (in.failed)
      return;
    children[depth]--;
    in.skip(in.fixed(1));
    if (++depth == METADATA_DEPTH) {
      in.failed = true;
      return;
    }
  }
}

void skip_metadata(reader &in) {
  for (uint32_t attributes = in.varint(); attributes > 0 && !in.failed; attributes--) {
    in.varint();
    skip_metadata_tree(in);
  }
  if (!in.failed)
    skip_metadata_tree(in);
}

} // namespace

/* Draco bitstream specification, sections "Header", "Metadata" and "Connectivity"; counts are varints since 2.0 (Edgebreaker) or 2.2
 * (sequential), 32 bits before. */
extern "C" enum lod_status lod_draco_inspect(const uint8_t *bytes, size_t size, struct lod_draco_header *header,
                                             struct lod_problem *problem) {
  if (size < 11 || std::memcmp(bytes, "DRACO", 5) != 0)
    return lod_fail(problem, LOD_BAD_INPUT, "draco", "Draco data should begin with the letters DRACO and a header of 11 bytes");
  const uint32_t version = bytes[5] * 256u + bytes[6];
  if (version < 0x0100 || bytes[5] > 2 || version > 0x0203)
    return lod_fail(problem, LOD_UNSUPPORTED, "draco-version", "Draco data has bitstream version %d.%d; 1.0 to 2.2 are known", bytes[5],
                    bytes[6]);
  header->mesh = bytes[7] == draco::TRIANGULAR_MESH;
  header->declared_vertices = header->declared_triangles = 0;
  reader in = {bytes + 9, bytes + size, false};
  const uint32_t flags = in.fixed(2);
  if (version >= 0x0103 && (flags & METADATA_FLAG) != 0)
    skip_metadata(in);
  if (!header->mesh) {
    header->declared_vertices = in.fixed(4);
  } else if (bytes[8] == draco::MESH_EDGEBREAKER_ENCODING) {
    const auto number = [&] { return version < 0x0200 ? in.fixed(4) : in.varint(); };
    in.fixed(1); /* traversal method */
    if (version < 0x0202)
      number(); /* new vertices, unused since 1.1 */
    header->declared_vertices = number();
    header->declared_triangles = number();
    in.fixed(1); /* attribute seams */
    const uint32_t symbols = number(), split = number();
    if (!in.failed && (symbols > header->declared_triangles || split > symbols))
      return lod_fail(problem, LOD_BAD_INPUT, "draco", "Draco data declares %u symbols, %u of them splits, for %u triangles", symbols,
                      split, header->declared_triangles);
  } else {
    const auto number = [&] { return version < 0x0202 ? in.fixed(4) : in.varint(); };
    header->declared_triangles = number();
    header->declared_vertices = number();
  }
  if (in.failed)
    return lod_fail(problem, LOD_BAD_INPUT, "truncated", "Draco data ends inside its header or its metadata is nested too deeply");
  return LOD_OK;
}

/* ---- decode ---- */

namespace {

/* A flat square grid on integer coordinates, as regular as meshes get, takes one byte for 99 triangles at 100 x 100 quads and for 920 at
 * 1600 x 1600 (measured at speed 0): what declares more is a bomb. */
constexpr uint64_t kTrianglesPerByte = 1024;
constexpr uint64_t kTrianglesFree = 1 << 16;

enum lod_status check_counts(const struct lod_draco_header &header, size_t size, const struct lod_draco_limits *limits,
                             struct lod_problem *problem) {
  if (limits != nullptr && limits->max_triangles != 0 && header.declared_triangles > limits->max_triangles)
    return lod_fail(problem, LOD_LIMIT, "limit-triangles", "Draco data declares %u triangles; the limit is %llu", header.declared_triangles,
                    (unsigned long long)limits->max_triangles);
  if (limits != nullptr && limits->max_vertices != 0 && header.declared_vertices > limits->max_vertices)
    return lod_fail(problem, LOD_LIMIT, "limit-vertices", "Draco data declares %u vertices; the limit is %llu", header.declared_vertices,
                    (unsigned long long)limits->max_vertices);
  const uint64_t most = kTrianglesFree + kTrianglesPerByte * size;
  if (header.declared_triangles > most || header.declared_vertices > most)
    return lod_fail(problem, LOD_BAD_INPUT, "count-implausible",
                    "Draco data declares %u vertices and %u triangles, which %zu bytes cannot hold", header.declared_vertices,
                    header.declared_triangles, size);
  return LOD_OK;
}

bool component_of(draco::DataType type, enum lod_draco_component *component) {
  switch (type) {
  case draco::DT_INT8:
    *component = LOD_DRACO_INT8;
    return true;
  case draco::DT_UINT8:
  case draco::DT_BOOL:
    *component = LOD_DRACO_UINT8;
    return true;
  case draco::DT_INT16:
    *component = LOD_DRACO_INT16;
    return true;
  case draco::DT_UINT16:
    *component = LOD_DRACO_UINT16;
    return true;
  case draco::DT_INT32:
    *component = LOD_DRACO_INT32;
    return true;
  case draco::DT_UINT32:
    *component = LOD_DRACO_UINT32;
    return true;
  case draco::DT_FLOAT32:
  case draco::DT_FLOAT64:
    *component = LOD_DRACO_FLOAT;
    return true;
  default:
    return false;
  }
}

enum lod_status copy_attribute(const draco::PointAttribute &from, uint32_t point_count, struct lod_arena *arena,
                               struct lod_draco_attribute *to, struct lod_problem *problem) {
  to->unique_id = from.unique_id();
  to->components = from.num_components();
  to->normalized = from.normalized();
  const int kind = static_cast<int>(from.attribute_type());
  to->kind = kind >= 0 && kind <= LOD_DRACO_GENERIC ? static_cast<enum lod_draco_kind>(kind) : LOD_DRACO_GENERIC;
  if (!component_of(from.data_type(), &to->component))
    return lod_fail(problem, LOD_UNSUPPORTED, "draco-type", "Draco attribute %u holds 64-bit integers, which glTF does not have",
                    to->unique_id);
  if (to->components < 1 || to->components > 16)
    return lod_fail(problem, LOD_BAD_INPUT, "draco", "Draco attribute %u has %d components; 1 to 16 are expected", to->unique_id,
                    to->components);
  const bool is_double = from.data_type() == draco::DT_FLOAT64;
  const size_t width = lod_draco_component_size(to->component), stride = width * to->components;
  const size_t source_stride = stride * (is_double ? 2 : 1);
  to->values = lod_arena_alloc(arena, point_count, stride);
  if (to->values == nullptr)
    return lod_fail_memory(problem);
  const draco::DataBuffer *buffer = from.buffer();
  if (buffer == nullptr || from.byte_stride() < static_cast<int64_t>(source_stride) || from.byte_offset() < 0 ||
      (!from.is_mapping_identity() && from.indices_map_size() < point_count))
    return lod_fail(problem, LOD_BAD_INPUT, "draco", "Draco attribute %u does not cover its points", to->unique_id);
  char *out = static_cast<char *>(to->values);
  for (uint32_t p = 0; p < point_count; p++, out += stride) {
    const uint64_t value = from.mapped_index(draco::PointIndex(p)).value();
    const uint64_t offset = static_cast<uint64_t>(from.byte_offset()) + value * static_cast<uint64_t>(from.byte_stride());
    if (value >= from.size() || offset + source_stride > buffer->data_size())
      return lod_fail(problem, LOD_BAD_INPUT, "draco", "Draco attribute %u has no value for point %u", to->unique_id, p);
    const uint8_t *source = buffer->data() + offset;
    if (!is_double) {
      std::memcpy(out, source, stride);
      continue;
    }
    for (int c = 0; c < to->components; c++) {
      double wide;
      std::memcpy(&wide, source + 8 * c, sizeof wide);
      /* Out of float's range becomes infinite, which the caller's check for finite coordinates finds. */
      const float narrow =
          std::fabs(wide) <= (double)std::numeric_limits<float>::max() ? (float)wide : (float)std::copysign(INFINITY, wide);
      std::memcpy(out + 4 * c, &narrow, sizeof narrow);
    }
  }
  return LOD_OK;
}

enum lod_status decode(const uint8_t *bytes, size_t size, const struct lod_draco_limits *limits, struct lod_arena *arena,
                       struct lod_draco_mesh *mesh, struct lod_problem *problem) {
  draco::DecoderBuffer buffer;
  buffer.Init(reinterpret_cast<const char *>(bytes), size);
  draco::Decoder decoder;
  auto result = decoder.DecodeMeshFromBuffer(&buffer);
  if (!result.ok())
    return lod_fail(problem, LOD_BAD_INPUT, "draco", "Draco data of %zu bytes cannot be decoded: %s", size, result.status().error_msg());
  const std::unique_ptr<draco::Mesh> decoded = std::move(result).value();
  /* Seams make more points than the header's vertices. */
  if (limits != nullptr && limits->max_vertices != 0 && decoded->num_points() > limits->max_vertices)
    return lod_fail(problem, LOD_LIMIT, "limit-vertices", "Draco data holds %u vertices; the limit is %llu", decoded->num_points(),
                    (unsigned long long)limits->max_vertices);
  mesh->point_count = decoded->num_points();
  mesh->triangle_count = decoded->num_faces();
  mesh->attribute_count = static_cast<uint32_t>(decoded->num_attributes());
  mesh->triangles = static_cast<uint32_t(*)[3]>(lod_arena_alloc(arena, mesh->triangle_count, sizeof *mesh->triangles));
  mesh->attributes = static_cast<struct lod_draco_attribute *>(lod_arena_calloc(arena, mesh->attribute_count, sizeof *mesh->attributes));
  if (mesh->triangles == nullptr || mesh->attributes == nullptr)
    return lod_fail_memory(problem);
  for (uint32_t t = 0; t < mesh->triangle_count; t++) {
    const draco::Mesh::Face &face = decoded->face(draco::FaceIndex(t));
    for (int corner = 0; corner < 3; corner++) {
      if (face[corner].value() >= mesh->point_count)
        return lod_fail(problem, LOD_BAD_INPUT, "index-out-of-range", "Draco triangle %u refers to point %u of %u", t, face[corner].value(),
                        mesh->point_count);
      mesh->triangles[t][corner] = face[corner].value();
    }
  }
  for (uint32_t i = 0; i < mesh->attribute_count; i++)
    LOD_TRY(copy_attribute(*decoded->attribute(static_cast<int>(i)), mesh->point_count, arena, &mesh->attributes[i], problem));
  return LOD_OK;
}

} // namespace

extern "C" enum lod_status lod_draco_decode(const uint8_t *bytes, size_t size, const struct lod_draco_limits *limits,
                                            struct lod_arena *arena, struct lod_draco_mesh *mesh, struct lod_problem *problem) {
  struct lod_draco_header header;
  LOD_TRY(lod_draco_inspect(bytes, size, &header, problem));
  if (!header.mesh)
    return lod_fail(problem, LOD_UNSUPPORTED, "draco-point-cloud", "Draco data holds a point cloud; a triangle mesh is expected");
  LOD_TRY(check_counts(header, size, limits, problem));
  return guarded(problem, [&] { return decode(bytes, size, limits, arena, mesh, problem); });
}

extern "C" const struct lod_draco_attribute *lod_draco_find(const struct lod_draco_mesh *mesh, uint32_t unique_id) {
  for (uint32_t i = 0; i < mesh->attribute_count; i++)
    if (mesh->attributes[i].unique_id == unique_id)
      return &mesh->attributes[i];
  return nullptr;
}

namespace {

template <typename T> void convert(const void *values, size_t count, bool normalized, float *out) {
  const T *in = static_cast<const T *>(values);
  for (size_t i = 0; i < count; i++) {
    const double value = (double)in[i];
    out[i] = (float)(normalized ? std::fmax(value / (double)std::numeric_limits<T>::max(), -1) : value);
  }
}

} // namespace

extern "C" float *lod_draco_floats(const struct lod_draco_mesh *mesh, const struct lod_draco_attribute *attribute,
                                   struct lod_arena *arena) {
  const size_t count = static_cast<size_t>(mesh->point_count) * attribute->components;
  float *out = static_cast<float *>(lod_arena_alloc(arena, count, sizeof *out));
  if (out == nullptr)
    return nullptr;
  switch (attribute->component) {
  case LOD_DRACO_INT8:
    convert<int8_t>(attribute->values, count, attribute->normalized, out);
    break;
  case LOD_DRACO_UINT8:
    convert<uint8_t>(attribute->values, count, attribute->normalized, out);
    break;
  case LOD_DRACO_INT16:
    convert<int16_t>(attribute->values, count, attribute->normalized, out);
    break;
  case LOD_DRACO_UINT16:
    convert<uint16_t>(attribute->values, count, attribute->normalized, out);
    break;
  case LOD_DRACO_INT32:
    convert<int32_t>(attribute->values, count, attribute->normalized, out);
    break;
  case LOD_DRACO_UINT32:
    convert<uint32_t>(attribute->values, count, attribute->normalized, out);
    break;
  case LOD_DRACO_FLOAT:
    std::memcpy(out, attribute->values, count * sizeof *out);
    break;
  }
  return out;
}
