#include "tests/fuzz/importing.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
  fuzz_import_at_most(data, size, "rib", 300); /* cutting patches up is most of a run */
  return 0;
}
