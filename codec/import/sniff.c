/* The format from the first bytes; the name's ending only where the content is plain text that several formats share, or unknown. */
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "codec/import/import.h"
#include "codec/import/number.h"

struct view {
  const uint8_t *bytes;
  size_t size;
};

static bool starts_with(struct view v, const char *magic) {
  size_t length = strlen(magic);
  return v.size >= length && memcmp(v.bytes, magic, length) == 0;
}

static struct view skip_space(struct view v) {
  if (starts_with(v, "\xEF\xBB\xBF"))
    v = (struct view){v.bytes + 3, v.size - 3};
  while (v.size > 0 && strchr(" \t\r\n", v.bytes[0]) && v.bytes[0] != 0)
    v = (struct view){v.bytes + 1, v.size - 1};
  return v;
}

static bool contains(struct view v, size_t within, const char *needle) {
  return memmem(v.bytes, v.size < within ? v.size : within, needle, strlen(needle)) != NULL;
}

static uint32_t little_u32(const uint8_t *p) {
  return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

/* "x.tar.OBJ" -> "obj"; NULL when there is none or it is no plain word. */
static const char *ending(const char *name, char out[12]) {
  const char *dot = name ? strrchr(name, '.') : NULL;
  if (!dot || strchr(dot, '/') || strlen(dot) < 2 || strlen(dot) > 11)
    return NULL;
  size_t n = 0;
  for (const char *p = dot + 1; *p; p++) {
    char c = *p >= 'A' && *p <= 'Z' ? (char)(*p - 'A' + 'a') : *p;
    if (!((c >= 'a' && c <= 'z') || (c >= '0' && c <= '9')))
      return NULL;
    out[n++] = c;
  }
  out[n] = 0;
  return out;
}

/* Endings that are passed on: to our readers and to assimp's importers that work from memory. */
static const char *const kEndings[] = {
    "glb",   "gltf", "ply", "stl",  "m",      "drc", "obj", "off", "fbx", "dae",     "3mf", "3ds", "x",
    "ac",    "ms3d", "cob", "lwo",  "lws",    "dxf", "nff", "smd", "raw", "ifc",     "xgl", "zgl", "b3d",
    "q3o",   "q3s",  "amf", "x3d",  "ase",    "hmp", "mdl", "md2", "md3", "md5mesh", "iqm", "ndo", "ogex",
    "blend", "sib",  "ter", "mesh", "assbin", "bpt", "bez", "bbp", "bv",  "rib",     "stp", "wrl", "zae",
};

static const char *known_ending(const char *name) {
  char word[12];
  if (!ending(name, word))
    return NULL;
  for (size_t i = 0; i < sizeof kEndings / sizeof *kEndings; i++)
    if (strcmp(word, kEndings[i]) == 0)
      return kEndings[i];
  return NULL;
}

static bool is_binary_stl(struct view v) {
  return v.size >= 84 && 84 + 50 * (uint64_t)little_u32(v.bytes + 80) == v.size;
}

static const char *sniff_binary(struct view v, const char *by_name) {
  if (starts_with(v, "glTF"))
    return "glb";
  if (starts_with(v, "ply\n") || starts_with(v, "ply\r") || starts_with(v, "ply "))
    return "ply";
  if (starts_with(v, "DRACO"))
    return "drc";
  if (starts_with(v, "Kaydara FBX Binary"))
    return "fbx";
  if (starts_with(v, "BLENDER"))
    return "blend";
  if (starts_with(v, "MS3D000000"))
    return "ms3d";
  if (starts_with(v, "PK\x03\x04"))
    return by_name && strcmp(by_name, "zae") == 0 ? "zae" : "3mf";
  if (starts_with(v, "FORM") && v.size >= 12 && memcmp(v.bytes + 8, "LW", 2) == 0)
    return "lwo";
  if (v.size >= 6 && v.bytes[0] == 0x4D && v.bytes[1] == 0x4D && little_u32(v.bytes + 2) <= v.size)
    return "3ds";
  if (is_binary_stl(v))
    return "stl";
  return NULL;
}

static const char *sniff_xml(struct view v) {
  if (contains(v, 4096, "<COLLADA"))
    return "dae";
  if (contains(v, 4096, "<amf"))
    return "amf";
  if (contains(v, 4096, "<X3D"))
    return "x3d";
  return NULL;
}

/* The first words of an OBJ: some line in the first 4 KiB starts with "v " and a number, and no line of another format came before. */
static bool looks_like_obj(struct view v) {
  size_t size = v.size < 65536 ? v.size : 65536;
  for (size_t i = 0; i + 2 < size; i++) {
    bool line_start = i == 0 || v.bytes[i - 1] == '\n' || v.bytes[i - 1] == '\r';
    if (line_start && v.bytes[i] == 'v' && (v.bytes[i + 1] == ' ' || v.bytes[i + 1] == '\t') && strchr(" +-.0123456789\t", v.bytes[i + 2]))
      return true;
    if (v.bytes[i] == 0)
      return false;
  }
  return false;
}

static bool looks_like_off(struct view v) {
  static const char *const kinds[] = {"OFF", "COFF", "NOFF", "STOFF", "CNOFF", "STCOFF", "STNOFF", "STCNOFF", "4OFF", "nOFF"};
  for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
    size_t n = strlen(kinds[i]);
    if (v.size > n && starts_with(v, kinds[i]) && strchr(" \t\r\n#", v.bytes[n]))
      return true;
  }
  return false;
}

/* A line of `count` numbers and no more; whole ones from 1 up where `most` is not 0. Moves past it. */
static bool line_of_numbers(struct view *v, int count, uint32_t most) {
  const char *at = (const char *)v->bytes, *end = memchr(at, '\n', v->size < 4096 ? v->size : 4096);
  if (end == NULL)
    return false;
  for (int i = 0; i < count; i++) {
    double value;
    lod_number_skip_blanks(&at, end);
    if (at == end || !lod_number_read(&at, end, &value))
      return false;
    if (most != 0 && !(value >= 1 && value <= most && value == (double)(uint32_t)value))
      return false;
  }
  lod_number_skip_space(&at, end);
  size_t read = (size_t)(end + 1 - (const char *)v->bytes);
  *v = (struct view){v->bytes + read, v->size - read};
  return at == end;
}

/* How many patches, the first one's two degrees, its first point: a line each. */
static bool looks_like_bpt(struct view v) {
  return line_of_numbers(&v, 1, UINT32_MAX) && line_of_numbers(&v, 2, 9) && line_of_numbers(&v, 3, 0);
}

static const char *sniff_text(struct view v, const char *by_name) {
  if (starts_with(v, "{") && (contains(v, v.size, "\"asset\"") || (by_name && strcmp(by_name, "gltf") == 0)))
    return "gltf";
  if (looks_like_off(v))
    return "off";
  if (starts_with(v, "solid") && (contains(v, 65536, "facet") || contains(v, 65536, "endsolid")))
    return "stl";
  if (starts_with(v, "xof "))
    return "x";
  if (starts_with(v, "; FBX") || contains(v, 1024, "FBXHeaderExtension"))
    return "fbx";
  if (starts_with(v, "<"))
    return sniff_xml(v);
  if (starts_with(v, "##RenderMan"))
    return "rib";
  if (starts_with(v, "BBP") || starts_with(v, "BEZ") || starts_with(v, "STBEZ") || starts_with(v, "STBBP"))
    return "bez";
  if (starts_with(v, "AC3D"))
    return "ac";
  if (starts_with(v, "ISO-10303-21"))
    return "ifc";
  if (starts_with(v, "#VRML"))
    return "wrl";
  if (starts_with(v, "Vertex ") || (contains(v, 4096, "\nVertex ") && contains(v, v.size, "\nFace ")))
    return "m";
  return NULL;
}

const char *lod_import_sniff(const uint8_t *bytes, size_t size, const char *name) {
  struct view v = {bytes, size};
  const char *by_name = known_ending(name);
  if (size == 0)
    return by_name;
  const char *format = sniff_binary(v, by_name);
  if (!format)
    format = sniff_text(skip_space(v), by_name);
  if (format)
    return format;
  /* Plain numbers and words: the name decides, when it says nothing, "v 1 2 3" lines are OBJ, and a count, degrees and points BPT. */
  if (by_name)
    return by_name;
  if (looks_like_obj(v))
    return "obj";
  return looks_like_bpt(skip_space(v)) ? "bpt" : NULL;
}
