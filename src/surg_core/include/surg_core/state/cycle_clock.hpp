// Time between cycles (F27): how many control periods have passed, and how late cycles come.
#pragma once

#include <array>
#include <cstdint>

namespace surg {

/// Converts the time since the last cycle into whole control periods. The rest of a period is
/// carried to the next cycle, so that the periods add up to real time.
class CycleClock {
 public:
  static constexpr double kLate = 2;      ///< [periods] a longer cycle is late
  static constexpr double kLong = 5;      ///< [periods] a longer one is a gap: was the arm stopped?
  static constexpr int kWindow = 128;     ///< [cycles] for the share of late ones
  static constexpr double kShare = 0.5;   ///< of late cycles; a larger one is an overrun
  static constexpr int kCatchUp = 25;     ///< [periods] a longer gap, or gaps in a row that
                                          ///< together are longer, are not made up for
  static constexpr double kMemory = 0.5;  ///< [s] in which cycles and states count as recent
  static constexpr int kMostPeriods = 500;  ///< that one cycle counts at most

  /// period [s] of control.
  explicit CycleClock(double period) : period_(period) {}

  /// Call it first in each cycle. elapsed [s] since the last one; 0: exactly one period.
  void advance(double elapsed);

  /// Periods since the last cycle; 0: it came early, and the last command stands.
  int periods() const { return periods_; }
  /// Real time since the last whole period [s], less than one period.
  double rest() const { return rest_ > 0 ? rest_ : 0; }
  /// Whether the last cycle was a gap.
  bool gap() const { return gaps_ > 0; }
  /// Whether the last cycles were gaps that are not made up for. At one command in each, a stop
  /// would take many times its way.
  bool starved() const;
  /// Length of the last cycle [s].
  double elapsed() const { return elapsed_; }
  /// How much longer than a period the recent cycles are on average [s].
  double excess() const { return excess_; }
  /// Share of late cycles in the window.
  double late_share() const { return static_cast<double>(n_late_) / kWindow; }
  /// Whether so many cycles are late that the arm must not move.
  bool overrun() const { return starved() || late_share() > kShare; }

 private:
  double period_;
  int periods_ = 1, n_late_ = 0, at_ = 0;
  double rest_ = 0;  // [s] since the last period that was counted; negative: before its end
  double elapsed_ = 0, excess_ = 0;
  double gaps_ = 0;  // [s] of the gaps in a row that end now
  std::array<std::uint8_t, kWindow> late_{};
};

}  // namespace surg
