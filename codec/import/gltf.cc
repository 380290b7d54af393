extern "C" {
#include "core/base/arena.h"
#include "core/base/status.h"
}

#include "codec/import/gltf.h"

#include <cctype>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <exception>
#include <fstream>
#include <new>
#include <string>

/* Compiled here, in a namespace of our own, rather than linked: Debian's libdraco exports an older tinygltf under the same names, and
 * whichever library the linker lists first would serve both. It also puts tinygltf under the sanitizers. */
#define tinygltf lod_tinygltf
#define TINYGLTF_IMPLEMENTATION
#define TINYGLTF_NO_STB_IMAGE
#define TINYGLTF_NO_STB_IMAGE_WRITE
#define TINYGLTF_NO_FS
#include <tiny_gltf.h>

namespace {

bool no_file(const std::string &, void *) {
  return false;
}
std::string no_expand(const std::string &, void *) {
  return std::string();
}
bool no_read(std::vector<unsigned char> *, std::string *, const std::string &, void *) {
  return false;
}
bool no_write(std::string *, const std::string &, const std::vector<unsigned char> &, void *) {
  return false;
}
bool no_image(tinygltf::Image *, const int, std::string *, std::string *, int, int, const unsigned char *, int, void *) {
  return true;
}

/* Thrown by the helpers below, caught in lod_gltf_parse. */
struct refused {
  const char *why;
};

template <typename T> T *make(struct lod_arena *arena, size_t count) {
  T *items = static_cast<T *>(lod_arena_calloc(arena, count, sizeof(T)));
  if (!items)
    throw std::bad_alloc();
  return items;
}

const char *copy(struct lod_arena *arena, const std::string &text) {
  const char *result = static_cast<const char *>(lod_arena_copy(arena, text.c_str(), std::strlen(text.c_str())));
  if (!result)
    throw std::bad_alloc();
  return result;
}

void compose(const tinygltf::Node &node, double m[16]) {
  if (node.matrix.size() == 16) {
    for (int i = 0; i < 16; i++)
      m[i] = node.matrix[static_cast<size_t>(i)];
    return;
  }
  double t[3] = {0, 0, 0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
  for (size_t i = 0; i < 3 && node.translation.size() == 3; i++)
    t[i] = node.translation[i];
  for (size_t i = 0; i < 3 && node.scale.size() == 3; i++)
    s[i] = node.scale[i];
  for (size_t i = 0; i < 4 && node.rotation.size() == 4; i++)
    q[i] = node.rotation[i];
  double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  if (!(length > 0) || !std::isfinite(length)) {
    q[0] = q[1] = q[2] = 0;
    q[3] = length = 1;
  }
  /* A rotation that is a unit quaternion up to its decimals keeps those decimals. */
  for (double &value : q)
    value = std::fabs(length - 1) > 1e-9 ? value / length : value;
  double x = q[0], y = q[1], z = q[2], w = q[3];
  const double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 2 * (x * y - z * w),    1 - 2 * (x * x + z * z),
                       2 * (y * z + x * w),     2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)};
  for (int column = 0; column < 3; column++) {
    for (int row = 0; row < 3; row++)
      m[column * 4 + row] = r[column * 3 + row] * s[column];
    m[column * 4 + 3] = 0;
    m[12 + column] = t[column];
  }
  m[15] = 1;
}

/* "JOINTS_2" with prefix "JOINTS_" -> 2; -1 when it is another name. */
int set_number(const std::string &name, const char *prefix) {
  size_t length = std::strlen(prefix);
  if (name.compare(0, length, prefix) != 0 || name.size() != length + 1 || name[length] < '0' || name[length] > '9')
    return -1;
  return name[length] - '0';
}

void fill_attribute(lod_gltf_primitive *out, const std::string &name, int accessor) {
  int uv = set_number(name, "TEXCOORD_"), joints = set_number(name, "JOINTS_"), weights = set_number(name, "WEIGHTS_");
  if (name == "POSITION")
    out->position = accessor;
  else if (name == "NORMAL")
    out->normal = accessor;
  else if (name == "COLOR_0")
    out->color = accessor;
  else if (name == "_DOI")
    out->interest = accessor;
  else if (name == "_EPSILON")
    out->epsilon = accessor;
  else if (uv == 0 || uv == 1)
    out->uv[uv] = accessor;
  else if (joints >= 0 && joints < LOD_GLTF_SKIN_SETS)
    out->joints[joints] = accessor;
  else if (weights >= 0 && weights < LOD_GLTF_SKIN_SETS)
    out->weights[weights] = accessor;
  else if (name == "TANGENT")
    out->has_tangent = true;
  else
    out->has_other = true;
}

void fill_primitive(lod_gltf_primitive *out, const tinygltf::Primitive &in) {
  *out =
      lod_gltf_primitive{in.mode, in.material, in.indices, -1, -1, {-1, -1}, -1, -1, -1, {-1, -1, -1, -1}, {-1, -1, -1, -1}, false, false};
  for (const auto &attribute : in.attributes)
    fill_attribute(out, attribute.first, attribute.second);
}

void fill_accessor(lod_gltf_accessor *out, const tinygltf::Accessor &in, int32_t no_view) {
  *out = lod_gltf_accessor{};
  out->view = in.bufferView == no_view ? -1 : in.bufferView;
  out->offset = in.byteOffset;
  out->count = in.count;
  out->component = in.componentType;
  out->components = tinygltf::GetNumComponentsInType(static_cast<uint32_t>(in.type));
  out->matrix = in.type == TINYGLTF_TYPE_MAT2 || in.type == TINYGLTF_TYPE_MAT3 || in.type == TINYGLTF_TYPE_MAT4;
  out->normalized = in.normalized;
  if (out->components < 1 || out->components > 16)
    throw refused{"an accessor has an unknown type"};
  if (!in.sparse.isSparse)
    return;
  if (in.sparse.count < 0 || in.sparse.indices.byteOffset < 0 || in.sparse.values.byteOffset < 0)
    throw refused{"a sparse accessor has a negative count or offset"};
  out->sparse_count = static_cast<uint64_t>(in.sparse.count);
  out->sparse_index_view = in.sparse.indices.bufferView;
  out->sparse_index_offset = static_cast<uint64_t>(in.sparse.indices.byteOffset);
  out->sparse_index_component = in.sparse.indices.componentType;
  out->sparse_value_view = in.sparse.values.bufferView;
  out->sparse_value_offset = static_cast<uint64_t>(in.sparse.values.byteOffset);
}

uint32_t append(uint32_t *list, uint32_t *count, const std::vector<int> &items) {
  uint32_t first = *count;
  for (int item : items)
    list[(*count)++] = static_cast<uint32_t>(item);
  return first;
}

void fill_lists(const tinygltf::Model &model, struct lod_arena *arena, struct lod_gltf *gltf) {
  size_t children = 0, joints = 0, roots = 0, primitives = 0;
  for (const auto &node : model.nodes)
    children += node.children.size();
  for (const auto &skin : model.skins)
    joints += skin.joints.size();
  for (const auto &scene : model.scenes)
    roots += scene.nodes.size();
  for (const auto &mesh : model.meshes)
    primitives += mesh.primitives.size();
  gltf->children = make<uint32_t>(arena, children);
  gltf->joints = make<uint32_t>(arena, joints);
  gltf->roots = make<uint32_t>(arena, roots);
  gltf->primitives = make<lod_gltf_primitive>(arena, primitives);
}

void fill(const tinygltf::Model &model, int32_t no_view, struct lod_arena *arena, struct lod_gltf *gltf) {
  *gltf = lod_gltf{};
  gltf->scene = model.defaultScene;
  fill_lists(model, arena, gltf);
  gltf->views = make<lod_gltf_view>(arena, model.bufferViews.size());
  for (const auto &view : model.bufferViews)
    gltf->views[gltf->view_count++] = lod_gltf_view{view.buffer, view.byteOffset, view.byteLength, view.byteStride};
  gltf->accessors = make<lod_gltf_accessor>(arena, model.accessors.size());
  for (const auto &accessor : model.accessors)
    fill_accessor(&gltf->accessors[gltf->accessor_count++], accessor, no_view);
  gltf->meshes = make<lod_gltf_mesh>(arena, model.meshes.size());
  for (const auto &mesh : model.meshes) {
    gltf->meshes[gltf->mesh_count++] =
        lod_gltf_mesh{copy(arena, mesh.name), gltf->primitive_count, static_cast<uint32_t>(mesh.primitives.size())};
    for (const auto &primitive : mesh.primitives)
      fill_primitive(&gltf->primitives[gltf->primitive_count++], primitive);
  }
  gltf->nodes = make<lod_gltf_node>(arena, model.nodes.size());
  for (const auto &node : model.nodes) {
    lod_gltf_node *out = &gltf->nodes[gltf->node_count++];
    out->name = copy(arena, node.name);
    out->mesh = node.mesh;
    out->skin = node.skin;
    out->child_count = static_cast<uint32_t>(node.children.size());
    out->first_child = append(gltf->children, &gltf->child_count, node.children);
    compose(node, out->matrix);
  }
  gltf->skins = make<lod_gltf_skin>(arena, model.skins.size());
  for (const auto &skin : model.skins) {
    uint32_t first = append(gltf->joints, &gltf->joint_count, skin.joints);
    gltf->skins[gltf->skin_count++] = lod_gltf_skin{first, static_cast<uint32_t>(skin.joints.size()), skin.inverseBindMatrices};
  }
  gltf->scenes = make<lod_gltf_scene>(arena, model.scenes.size());
  for (const auto &scene : model.scenes) {
    uint32_t first = append(gltf->roots, &gltf->root_count, scene.nodes);
    gltf->scenes[gltf->scene_count++] = lod_gltf_scene{first, static_cast<uint32_t>(scene.nodes.size())};
  }
}

} // namespace

enum lod_status lod_gltf_parse(const char *json, size_t size, int32_t no_view, struct lod_arena *arena, struct lod_gltf *gltf,
                               char message[200]) {
  try {
    tinygltf::TinyGLTF loader;
    tinygltf::Model model;
    std::string error, warning;
    loader.SetImageLoader(no_image, nullptr);
    loader.SetFsCallbacks(tinygltf::FsCallbacks{no_file, no_expand, no_read, no_write, nullptr});
    if (size > 0xFFFFFFFFu)
      throw refused{"the JSON has 4 GiB or more"};
    if (!loader.LoadASCIIFromString(&model, &error, &warning, json, static_cast<unsigned int>(size), "")) {
      for (char &c : error)
        c = c == '\n' ? ' ' : c;
      while (!error.empty() && std::isspace(static_cast<unsigned char>(error.back())) != 0)
        error.pop_back();
      std::snprintf(message, 200, "%s", error.c_str());
      return LOD_BAD_INPUT;
    }
    fill(model, no_view, arena, gltf);
    return LOD_OK;
  } catch (const refused &reason) {
    std::snprintf(message, 200, "%s", reason.why);
    return LOD_BAD_INPUT;
  } catch (const std::bad_alloc &) {
    std::snprintf(message, 200, "memory is out");
    return LOD_MEMORY;
  } catch (const std::exception &exception) {
    std::snprintf(message, 200, "%s", exception.what());
    return LOD_BAD_INPUT;
  } catch (...) {
    std::snprintf(message, 200, "unknown failure");
    return LOD_BAD_INPUT;
  }
}
