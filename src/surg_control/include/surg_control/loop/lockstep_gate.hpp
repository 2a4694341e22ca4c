// Lock-step: holds commands until every declared participant has said "that was all for this tick",
// then gives them out in an order that no network can change (docs/reference/conventions.md,
// lock-step). Pure.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "surg_control/loop/cycle_data.hpp"

namespace surg_control {

/// One arm's inbox between two ticks. Participants are known by their caller id without the leading
/// '/'.
class LockstepGate {
 public:
  /// Of one sender on one topic: 16 ticks' worth, two orders of magnitude above any stream.
  static constexpr std::size_t kMostWaiting = 1024;

  explicit LockstepGate(const std::vector<std::string>& participants);

  bool declared(const std::string& sender) const { return participants_.count(sender) != 0; }

  /// Counts a message of any command topic, also one that was refused while decoding.
  void received(const std::string& sender);
  /// Keeps a decoded command for the next tick. False when kMostWaiting of the same sender and
  /// topic wait already: it is dropped. All of a tick is here before the tick is taken, so that a
  /// participant's drops are the same in every run.
  bool push(const std::string& sender, const std::string& topic, const CommandItem& item);
  /// "For this tick I have sent 'sent' messages to this arm since I started." Others than declared
  /// participants are not waited for.
  void ready(const std::string& participant, std::uint64_t tick, std::uint64_t sent);

  /// Whether every participant is ready for the tick and all it has sent is here.
  bool due(std::uint64_t tick) const;
  /// Who is waited for and why, for people; empty when due.
  std::string missing(std::uint64_t tick) const;

  /// The commands of this tick: state commands first, then taught trocars, base frames, claims,
  /// trocar samples, then motions; within each what an earlier tick left over, then the
  /// participants by name, their topics by name, each topic in its own order; undeclared senders
  /// last, as they came. At most surg::kMaxCommands; what is left waits for the next tick.
  const std::vector<CommandItem>& take();

 private:
  struct Participant {
    std::uint64_t received = 0;
    std::uint64_t ready_tick = 0;
    std::uint64_t sent = 0;
  };
  struct Letter {
    bool declared;
    std::string sender, topic;  // empty for undeclared senders: only the order counts
    std::uint64_t round;        // of the take() before which it came
    std::uint64_t number;
    CommandItem item;
  };

  std::map<std::string, Participant> participants_;
  std::vector<Letter> inbox_;
  std::map<std::pair<std::string, std::string>, std::size_t> waiting_;  // by sender, topic
  std::uint64_t round_ = 0, count_ = 0;
  std::vector<CommandItem> taken_;
};

}  // namespace surg_control
