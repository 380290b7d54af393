/* The OpenAPI document as bytes of this program. The path is relative to the repository's root, where the compiler runs; a test checks that
 * the embedded bytes are the file's. */
#include "server/http/routes.h"

__asm__(".section .rodata\n"
        ".global lod_openapi_json\n"
        ".global lod_openapi_json_end\n"
        "lod_openapi_json:\n"
        ".incbin \"server/http/openapi.json\"\n"
        "lod_openapi_json_end:\n"
        ".byte 0\n"
        ".previous\n");
