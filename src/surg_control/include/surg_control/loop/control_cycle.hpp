// One control cycle without ROS: applies decoded commands to the controller, steps it once and
// fills the record. Lock-step, free-run and unit tests use the same code.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string_view>

#include "surg_control/loop/cycle_data.hpp"
#include "surg_control/loop/stamp_history.hpp"
#include "surg_core/state/black_box.hpp"

namespace surg_control {

/// Drives one surg::Controller through its black box. Allocates nothing after construction.
class ControlCycle {
 public:
  /// 'rcm_frame': name of the rcm frame, the frame of all commands until a base frame is set.
  ControlCycle(const surg::Controller& controller, surg::BlackBox& box, std::string_view rcm_frame);

  /// Applies state commands, trocar points, frames, claims and trocar samples first, then steps the
  /// controller with the motion commands in the order given. Takes at most surg::kMaxCommands
  /// items, sorted by kind or not; the caller keeps the rest. 'now_ns': the steady clock, in
  /// lock-step the tick; ages refer to it. 'elapsed_ns': since the last cycle; 0: one period, as in
  /// lock-step. The caller sets tick, timing and refused_by_node of the
  /// record.
  const CycleRecord& run(const LinkState& link, std::int64_t now_ns, std::int64_t elapsed_ns,
                         const CommandItem* items, std::size_t count);

  /// From now on a tip deeper than 'depth' [m] needs known forces at tip and trocar (F25).
  void require_force_below(double depth) { force_depth_ = depth; }
  CycleRecord& record() { return record_; }
  /// The controller's inputs in the last cycle.
  const surg::Inputs& inputs() const { return inputs_; }

 private:
  struct Track {
    std::int64_t received_ns = 0;
    std::uint32_t source = 0;  // 0: there is no sample
    surg::Vector3 p_B = surg::Vector3::Zero(), v_B = surg::Vector3::Zero();
  };

  surg::Reason answer(const CommandItem& item, std::int64_t now_ns);
  surg::Reason request(surg::StateCommand command);
  surg::Reason change_tool(const surg::MountedTool& tool);
  surg::Reason set_frame(const CommandItem& item);
  /// Copies the controller's fixtures into the record when they have changed.
  void note_fixtures();
  surg::Reason take_track(const CommandItem& item, std::int64_t now_ns);
  surg::Reason take_motion(const CommandItem& item, std::int64_t now_ns);
  bool is_sliding(std::uint32_t source) const;
  surg::Reason set_sliding(std::uint32_t source, bool slide);
  void sense(const LinkState& link, std::int64_t now_ns);
  Eigen::Quaterniond orientation_at(const surg::Vector3& p_B, double roll) const;

  const surg::Controller& controller_;
  surg::BlackBox& box_;  // every call that changes the controller goes through it
  FrameName rcm_frame_;
  double force_depth_ = std::numeric_limits<double>::infinity();  // [m] forces required below
  bool enabled_ = false, homed_ = false;
  Track track_;
  std::array<std::uint32_t, 16>
      sliding_{};  // senders whose servo_cp slides along the wall; 0: none
  StampHistory stamps_seen_;
  surg::Inputs inputs_;
  CycleRecord record_;
};

}  // namespace surg_control
