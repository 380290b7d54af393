/* A bare Draco mesh. libdraco itself is not instrumented; what is looked for is ours around it. */
#include "tests/fuzz/importing.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  fuzz_import(data, size, "drc");
  return 0;
}
