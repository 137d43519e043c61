/* SPDX-License-Identifier: Apache-2.0 */
/* OpenImageIO behind a C interface. No exception leaves this file. */
#include "cli/image_oiio.h"

#include <OpenImageIO/imageio.h>

#include <cstdio>
#include <exception>
#include <memory>
#include <string>

namespace
{

int fail(char *error, size_t error_bytes, const std::string &sentence)
{
    std::string line = sentence.substr(0, sentence.find('\n'));
    std::snprintf(error, error_bytes, "%s", line.c_str());
    return -1;
}

int write(const char *path, uint32_t width, uint32_t height, const uint8_t *pixels, char *error, size_t error_bytes)
{
    std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create(path);
    if (!output) return fail(error, error_bytes, "no picture format of that extension is known");

    OIIO::ImageSpec spec(static_cast<int>(width), static_cast<int>(height), 3, OIIO::TypeDesc::UINT8);
    spec.attribute("oiio:ColorSpace", "sRGB");
    if (!output->open(path, spec)) return fail(error, error_bytes, output->geterror());
    const bool is_good = output->write_image(OIIO::TypeDesc::UINT8, pixels);
    const bool is_closed = output->close();
    if (is_good && is_closed) return 0;
    std::remove(path);
    return fail(error, error_bytes, output->geterror());
}

} // namespace

extern "C" int cli_image_write_oiio(const char *path, uint32_t width, uint32_t height, const uint8_t *pixels,
                                    char *error, size_t error_bytes)
{
    try {
        return write(path, width, height, pixels, error, error_bytes);
    } catch (const std::exception &e) {
        return fail(error, error_bytes, e.what());
    } catch (...) {
        return fail(error, error_bytes, "OpenImageIO failed");
    }
}
