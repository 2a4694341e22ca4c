// Reads and writes black box files atomically.
#pragma once

#include <string>

#include "surg_core/state/black_box.hpp"

namespace surg_control {

/// Writes 'recording' to 'path': to a temporary file that is flushed and renamed, so that a partial
/// file never appears, even after a power cut. The folder must exist. Blocks on the disk: never
/// call it from the control thread. Throws surg::BlackBoxError.
void write_black_box(const std::string& path, const surg::BlackBoxRecording& recording);

/// Reads a file. Throws surg::BlackBoxError with path, problem and remedy.
surg::BlackBoxRecording read_black_box(const std::string& path);

}  // namespace surg_control
