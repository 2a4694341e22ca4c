// The jaw: follows its goal at a limited rate. Nothing but a command ever moves it (F31).
#pragma once

#include "surg_core/config.hpp"

namespace surg {

class Jaw {
 public:
  /// dt: control period [s].
  Jaw(const InstrumentConfig& instrument, double dt);

  /// A measured angle [rad], not finite where there is none. The first one tells where the jaw is;
  /// until then it is not told to move.
  void sense(double measured);
  /// A goal [rad], clamped to the jaw's range. 'move': busy until the jaw is there.
  void go_to(double angle, bool move);
  /// Stays where it is: on a stop, a pause, a fault.
  void hold();
  /// One period; only while the arm is ENABLED and the tool link alive.
  void advance(bool may_move);

  double setpoint() const { return set_; }  ///< [rad]; not a number until measured
  bool busy() const { return busy_; }

 private:
  double min_, max_, velocity_, dt_;
  double set_, goal_, measured_;
  bool busy_ = false;
  double settle_ = 0;  ///< [s] since the set-point has arrived
};

}  // namespace surg
