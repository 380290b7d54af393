/* The file is its own MTL file and textures, whatever it names. */
#include "tests/fuzz/importing.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  fuzz_import(data, size, "obj");
  return 0;
}
