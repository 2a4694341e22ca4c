// Limits the rate of the set-point's clock so that the joints can brake on the path ahead.
#pragma once

#include <array>

#include "limits/limited_laws.hpp"

namespace surg {

/// Samples the path ahead at nodes of growing spacing and computes backwards from the last one the
/// largest clock rate from which the joints can stop at the end. A plan to stop thus exists in
/// every cycle.
class LimitedStep::LookAhead {
 public:
  /// affine: the law at 'here'.
  LookAhead(const LimitedStep& self, const Law& law, const Here& here, const Affine& affine);

  /// Largest allowed alpha, and the limit that sets it.
  Cap cap() const { return {alpha(), by_}; }

 private:
  static constexpr int kNodes = 14;  ///< of the preview at most

  double alpha() const;
  bool advance(const Law& law, const Here& here);
  double fastest() const;
  bool plan();
  double fastest_before(int i, const Joints& most) const;
  bool passes(const SingularityMeasures& to) const;
  bool inside_positions(const Joints& q, const Joints& from) const;

  const LimitedStep& self_;
  const Eigen::Index n_;  ///< joints
  // The joints' limits; places without a joint bind nothing.
  Joints acceleration_ = Joints::Ones(), velocity_ = Joints::Constant(INFINITY);
  Joints position_min_ = Joints::Constant(-INFINITY), position_max_ = Joints::Constant(INFINITY);
  /// Acceleration times the distance from which a limit says nothing.
  Joints far_ = Joints::Zero();
  double horizon_;
  int last_ = 0, planned_ = 0;                     ///< index of the last node; 0 is here
  std::array<double, kNodes + 1> t_{}, square_{};  ///< [s] of the clock; its largest squared speed
  std::array<double, kNodes + 1> most_{};          ///< what flange and joints allow of it there
  /// Joint accelerations between two nodes by the squared speeds at the first and the second.
  std::array<Joints, kNodes> from_, to_;
  double flange_velocity_;  ///< [m/s] what there is of the limit
  Node node_;               ///< the last
  double spacing_, arc_;
  int evaluations_ = 0;
  const char* by_ = "preview";
};

}  // namespace surg
