# SPDX-License-Identifier: GPL-2.0-or-later
# cmake -DROOT=dir -DOUT=file.cpp -DFILES=a;b -DHEADER=x.hpp -DNAME=projectFiles -P EmbedFiles.cmake
# Writes the text of each file, and whether it is executable, into a C++ source: what NAME() of axon::cli returns.
set(text "// Written by EmbedFiles.cmake.\n#include \"${HEADER}\"\n\nnamespace axon::cli {\nconst std::vector<EmbeddedFile>& ${NAME}() {\n    static const std::vector<EmbeddedFile> all{\n")
foreach(file IN LISTS FILES)
  file(READ "${ROOT}/${file}" content)
  if(content MATCHES "\\)embedded\"")
    message(FATAL_ERROR "${file} has the end mark of a raw string")
  endif()
  set(executable false)
  execute_process(COMMAND test -x "${ROOT}/${file}" RESULT_VARIABLE not_executable)
  if(not_executable EQUAL 0)
    set(executable true)
  endif()
  string(APPEND text "        {\"${file}\", ${executable}, R\"embedded(${content})embedded\"},\n")
endforeach()
string(APPEND text "    };\n    return all;\n}\n}  // namespace axon::cli\n")
file(WRITE "${OUT}" "${text}")
