/* The first byte chooses the format, the rest is the file. assimp itself is not instrumented; what is looked for is ours around it. */
#include "tests/fuzz/importing.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
const char *__lsan_default_suppressions(void);

/* Its importers leak when they give up in the middle; a worker's memory goes with the worker. */
const char *__lsan_default_suppressions(void) {
  return "leak:libassimp";
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  static const char *const kFormats[] = {"amf", "dae", "x", "3ds", "fbx", "3mf"};
  if (size > 0)
    fuzz_import(data + 1, size - 1, kFormats[data[0] % (sizeof kFormats / sizeof *kFormats)]);
  return 0;
}
