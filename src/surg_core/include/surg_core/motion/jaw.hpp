// The jaw follows its goal at a limited rate. Only a command moves it (F31).
#pragma once

#include "surg_core/config.hpp"

namespace surg {

class Jaw {
 public:
  static constexpr double kEdge = 0.01;  ///< [s] 'busy' lasts, so that a client can see it

  /// dt: control period [s].
  Jaw(const InstrumentConfig& instrument, double dt);

  /// Takes a measured angle [rad], not finite without a measurement. The first one initialises the
  /// set-point; until then the jaw gets no command.
  void sense(double measured);
  /// A goal [rad], clamped to the jaw's range. 'move': busy until the jaw is there.
  void go_to(double angle, bool move);
  /// Holds the present angle: on a stop, pause or fault.
  void hold();
  /// Advances one period. may_move: the arm is ENABLED and the tool link alive. periods: how many
  /// have passed; the jaw does not make up for more than one.
  void advance(bool may_move, int periods = 1);

  double setpoint() const { return set_; }  ///< [rad]; not a number until measured
  bool busy() const { return busy_; }

 private:
  double min_, max_, velocity_, dt_;
  double set_, goal_, measured_;
  bool busy_ = false;
  double settle_ = 0;  ///< [s] since the set-point has arrived
};

}  // namespace surg
