# SPDX-License-Identifier: Apache-2.0
# CMake toolchain: 64-bit Windows by Debian's mingw-w64, with POSIX threads.
set(CMAKE_SYSTEM_NAME Windows)
set(CMAKE_SYSTEM_PROCESSOR x86_64)
set(CMAKE_C_COMPILER x86_64-w64-mingw32-gcc-posix)
set(CMAKE_CXX_COMPILER x86_64-w64-mingw32-g++-posix)
set(CMAKE_RC_COMPILER x86_64-w64-mingw32-windres)
set(CMAKE_FIND_ROOT_PATH /usr/x86_64-w64-mingw32)
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
# Windows aligns stacks to 16 bytes and GCC does not align them further there (GCC bug 54412): spilled vectors of 32
# and 64 bytes would fault with aligned moves. On aligned addresses the unaligned ones are as fast.
add_compile_options(-Wa,-muse-unaligned-vector-move)
