// Black boxes on disk: whole or not there.
#pragma once

#include <string>

#include "surg_core/state/black_box.hpp"

namespace surg_control {

/// Writes 'recording' to 'path': to a neighbour first, flushed, then renamed, so that nobody ever
/// sees half a file, not even after a power cut. The folder must exist. Blocks on the disk: never
/// call it from the control thread. Throws surg::BlackBoxError.
void write_black_box(const std::string& path, const surg::BlackBoxRecording& recording);

/// Reads one back. Throws surg::BlackBoxError with path, what is wrong and what to do.
surg::BlackBoxRecording read_black_box(const std::string& path);

}  // namespace surg_control
