#include "surg_control/loop/lockstep_gate.hpp"

#include <algorithm>
#include <functional>
#include <tuple>

namespace surg_control {

LockstepGate::LockstepGate(const std::vector<std::string>& participants) {
  for (const std::string& name : participants) participants_[name] = {};
}

void LockstepGate::received(const std::string& sender) {
  const auto found = participants_.find(sender);
  if (found != participants_.end()) ++found->second.received;
}

bool LockstepGate::push(const std::string& sender, const std::string& topic,
                        const CommandItem& item) {
  const bool known = declared(sender);
  std::size_t& waiting = waiting_[{known ? sender : "", known ? topic : ""}];
  if (waiting >= kMostWaiting) return false;
  ++waiting;
  inbox_.push_back({known, known ? sender : "", known ? topic : "", round_, ++count_, item});
  return true;
}

void LockstepGate::ready(const std::string& participant, std::uint64_t tick, std::uint64_t sent) {
  const auto found = participants_.find(participant);
  if (found == participants_.end() || tick < found->second.ready_tick) return;
  if (tick > found->second.ready_tick) found->second.ready_before = found->second.ready_tick;
  found->second.ready_tick = tick;
  found->second.sent = sent;
}

bool LockstepGate::due(std::uint64_t tick) const {
  return std::all_of(participants_.begin(), participants_.end(), [tick](const auto& entry) {
    return entry.second.ready_for(tick) && entry.second.received >= entry.second.sent;
  });
}

std::string LockstepGate::missing(std::uint64_t tick) const {
  std::string text;
  for (const auto& [name, participant] : participants_) {
    std::string why;
    if (!participant.ready_for(tick)) {
      why = "is not ready for tick " + std::to_string(tick) +
            " (its last: " + std::to_string(participant.ready_tick) + ")";
    } else if (participant.received < participant.sent) {
      why = "has sent " + std::to_string(participant.sent) + " messages of which " +
            std::to_string(participant.received) + " arrived";
    }
    if (!why.empty()) text += (text.empty() ? "" : "; ") + name + " " + why;
  }
  return text;
}

const std::vector<CommandItem>& LockstepGate::take() {
  const auto key = [](const PendingCommand& command) {
    return std::make_tuple(command.item.kind, command.round, !command.declared,
                           std::cref(command.sender), std::cref(command.topic), command.number);
  };
  std::sort(inbox_.begin(), inbox_.end(),
            [&key](const PendingCommand& a, const PendingCommand& b) { return key(a) < key(b); });
  ++round_;
  const std::size_t n = std::min<std::size_t>(inbox_.size(), surg::kMaxCommands);
  taken_.clear();
  for (std::size_t i = 0; i < n; ++i) {
    taken_.push_back(inbox_[i].item);
    --waiting_[{inbox_[i].sender, inbox_[i].topic}];
  }
  inbox_.erase(inbox_.begin(), inbox_.begin() + static_cast<std::ptrdiff_t>(n));
  return taken_;
}

}  // namespace surg_control
