// Recomputes the shaft's geometry from recorded joints, without ROS, to compare with the recording.
#pragma once

#include <cstdint>
#include <istream>
#include <ostream>
#include <stdexcept>

#include "surg_core/config.hpp"
#include "surg_core/kinematics/kinematics.hpp"

namespace surg_control {

/// A CSV that cannot be replayed: line and column.
class ReplayError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Largest differences between recomputed and recorded values [m].
struct ReplayReport {
  std::uint64_t rows = 0;     ///< recomputed
  std::uint64_t skipped = 0;  ///< without a joint state
  double tip = 0, depth = 0, rcm_error = 0;
  double worst() const;
};

/// Reads cycle_<arm>.csv from 'in' and writes stamp_ns, tick, p_tip, depth, rcm_error, recomputed
/// by forward kinematics and surg::shaft_state with the recorded pivot, to 'out'. Throws
/// ReplayError.
ReplayReport replay(std::istream& in, std::ostream& out, const surg::Chain& chain,
                    const surg::ToolCalibration& tool);

}  // namespace surg_control
