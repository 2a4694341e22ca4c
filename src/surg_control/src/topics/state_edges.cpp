#include "surg_control/topics/state_edges.hpp"

namespace surg_control {
namespace {

constexpr std::uint64_t kPeriodTicks = 50;  // 10 Hz

}  // namespace

StateEdges::Report StateEdges::next(const CycleRecord& record) {
  const surg::Outputs& out = record.out;
  const std::uint32_t moves = record.moves + record.moves_refused_by_node;
  const bool asked = moves != moves_;
  const bool busy = out.busy || asked;
  const bool changed =
      first_ || asked || busy != busy_ || out.state != state_ || out.homed != homed_;
  first_ = false;
  state_ = out.state;
  homed_ = out.homed;
  busy_ = busy;
  moves_ = moves;
  return {changed || record.tick % kPeriodTicks == 0, busy};
}

}  // namespace surg_control
