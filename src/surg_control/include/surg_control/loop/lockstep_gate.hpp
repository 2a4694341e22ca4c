// Lock-step: collects commands until every declared participant has finished the tick, then
// releases them in an order independent of the network (docs/reference/conventions.md, lock-step).
// Pure.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "surg_control/loop/cycle_data.hpp"

namespace surg_control {

/// One arm's pending commands between two ticks. Participants are identified by their caller id
/// without the leading '/'.
class LockstepGate {
 public:
  /// Per sender and topic: 16 ticks' worth, a hundred times the rate of any stream.
  static constexpr std::size_t kMostWaiting = 1024;

  explicit LockstepGate(const std::vector<std::string>& participants);

  bool declared(const std::string& sender) const { return participants_.count(sender) != 0; }

  /// Counts a message of any command topic, also one that was refused while decoding.
  void received(const std::string& sender);
  /// Stores a decoded command for the next tick. Returns false and drops it if kMostWaiting of the
  /// same sender and topic are pending. All commands of a tick arrive before it is taken, so a
  /// participant's drops are the same in every run.
  bool push(const std::string& sender, const std::string& topic, const CommandItem& item);
  /// A participant's message: for the ticks since its last one and up to this it has sent 'sent'
  /// messages to this arm since its start. Senders that are not declared are not waited for.
  void ready(const std::string& participant, std::uint64_t tick, std::uint64_t sent);

  /// Whether every participant is ready for the tick and all its messages have arrived.
  bool due(std::uint64_t tick) const;
  /// The participants that are missing and why, for people; empty when due.
  std::string missing(std::uint64_t tick) const;

  /// Takes the commands of this tick, at most surg::kMaxCommands; the rest waits for the next tick.
  /// Order: state commands, trocar points, base frames, claims, trocar samples, motions. Within
  /// each kind: leftovers of earlier ticks, then participants by name, their topics by name, each
  /// topic in its own order; undeclared senders last, in order of arrival.
  const std::vector<CommandItem>& take();

 private:
  struct Participant {
    std::uint64_t received = 0;
    std::uint64_t ready_before = 0, ready_tick = 0;
    std::uint64_t sent = 0;

    bool ready_for(std::uint64_t tick) const { return ready_before < tick && tick <= ready_tick; }
  };
  struct PendingCommand {
    bool declared;
    std::string sender, topic;  // empty for undeclared senders: only the order counts
    std::uint64_t round;        // of the take() before which it came
    std::uint64_t number;
    CommandItem item;
  };

  std::map<std::string, Participant> participants_;
  std::vector<PendingCommand> inbox_;
  std::map<std::pair<std::string, std::string>, std::size_t> waiting_;  // by sender, topic
  std::uint64_t round_ = 0, count_ = 0;
  std::vector<CommandItem> taken_;
};

}  // namespace surg_control
