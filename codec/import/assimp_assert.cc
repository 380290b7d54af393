#include "codec/import/assimp_assert.h"

#include <stdexcept>
#include <string>

namespace Assimp {
[[noreturn]] void aiAssertViolation(const char *expression, const char *file, int line);

void aiAssertViolation(const char *expression, const char *, int) {
  throw std::runtime_error(std::string("the file contradicts itself where it must hold that ") + expression);
}
} // namespace Assimp

extern "C" void lod_assimp_catch_assertions(void) {}
