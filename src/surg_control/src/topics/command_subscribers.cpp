#include "surg_control/topics/command_subscribers.hpp"

#include <ros/message_traits.h>
#include <ros/serialization.h>
#include <std_msgs/Empty.h>
#include <surg_msgs/ReceivedCommand.h>

#include <utility>

#include "surg_control/topics/messages.hpp"

namespace surg_control {
namespace {

constexpr std::uint32_t kUnbounded = 0;    // lock-step loses nothing
constexpr std::uint32_t kEchoQueue = 500;  // free-run: a second of one stream at 500 Hz

}  // namespace

using crtk_msgs::StringStamped;
using geometry_msgs::PoseStamped;
using geometry_msgs::TwistStamped;
using sensor_msgs::JointState;
using surg::Motion;

CommandSubscribers::CommandSubscribers(ros::NodeHandle& node, const std::string& arm, bool wristed,
                                       bool track, std::uint32_t queue, ToolReader read_tool,
                                       Sink sink)
    : node_(node),
      arm_(arm),
      queue_(queue),
      sink_(std::move(sink)),
      echo_(node.advertise<surg_msgs::ReceivedCommand>(
          "/" + arm + "/received", queue == kUnbounded ? kUnbounded : kEchoQueue)) {
  subscribe_motions(wristed);
  subscribe_others(track, read_tool);
}

template <typename Message>
void CommandSubscribers::subscribe(const std::string& topic,
                                   std::function<Decoded(const Message&)> decode) {
  using Event = ros::MessageEvent<const Message>;
  const boost::function<void(const Event&)> callback = [this, topic, decode](const Event& event) {
    const Message& message = *event.getConstMessage();
    const ros::Time* stamp = ros::message_traits::timeStamp(message);
    echo(topic, event.getPublisherName(), message);
    sink_(topic, event.getPublisherName(), stamp == nullptr ? ros::Time() : *stamp,
          decode(message));
  };
  subscribers_.push_back(node_.subscribe<Message>("/" + arm_ + "/" + topic, queue_, callback,
                                                  ros::VoidConstPtr(),
                                                  ros::TransportHints().tcpNoDelay()));
}

/// Says what came. A recorder hears this, not the command's own topic: a client takes the first
/// subscriber of its topic for the controller, and its first command would go to the recorder
/// alone.
template <typename Message>
void CommandSubscribers::echo(const std::string& topic, const std::string& sender,
                              const Message& message) {
  if (echo_.getNumSubscribers() == 0) return;
  surg_msgs::ReceivedCommand received;
  received.header.stamp = wall_time();
  received.topic = topic;
  received.sender = sender;
  received.type = ros::message_traits::datatype<Message>();
  received.data.resize(ros::serialization::serializationLength(message));
  ros::serialization::OStream stream(received.data.data(),
                                     static_cast<std::uint32_t>(received.data.size()));
  ros::serialization::serialize(stream, message);
  echo_.publish(received);
}

void CommandSubscribers::subscribe_motions(bool wristed) {
  for (const Motion motion : {Motion::kServoCp, Motion::kInterpolateCp, Motion::kMoveCp}) {
    subscribe<PoseStamped>(topic_of(motion), [motion](const PoseStamped& message) {
      return decode_pose(message, motion);
    });
  }
  for (const Motion motion : {Motion::kServoJp, Motion::kServoJr, Motion::kServoJv,
                              Motion::kInterpolateJp, Motion::kMoveJp, Motion::kMoveJr}) {
    subscribe<JointState>(topic_of(motion), [motion, wristed](const JointState& message) {
      return decode_joints(message, motion, wristed);
    });
  }
  for (const Motion motion : {Motion::kJawServoJp, Motion::kJawMoveJp, Motion::kElbowMoveJp}) {
    subscribe<JointState>(topic_of(motion), [motion](const JointState& message) {
      return decode_angle(message, motion);
    });
  }
  for (const Motion motion : {Motion::kInsert, Motion::kWithdraw, Motion::kRetrace}) {
    subscribe<StringStamped>(topic_of(motion), [motion](const StringStamped& message) {
      return decode_start_stop(message, motion);
    });
  }
  subscribe<TwistStamped>(topic_of(Motion::kServoCv), decode_twist);
  subscribe<std_msgs::Empty>(topic_of(Motion::kHold),
                             [](const std_msgs::Empty&) { return decode_hold(); });
}

void CommandSubscribers::subscribe_others(bool track, const ToolReader& read_tool) {
  const std::string base = arm_ + "_base";
  const std::string rcm = arm_ + "_rcm";
  const std::string user = arm_ + "_user";
  subscribe<StringStamped>("state_command", decode_state);
  subscribe<std_msgs::Empty>("authority/claim",
                             [](const std_msgs::Empty&) { return decode_claim(); });
  subscribe<StringStamped>("servo_cp/at_wall", decode_at_wall);
  subscribe<StringStamped>("tool/mount", [read_tool](const StringStamped& message) {
    return read_tool(message.string);
  });
  subscribe<PoseStamped>("set_base_frame", [rcm, user](const PoseStamped& message) {
    return decode_base_frame(message, rcm, user);
  });
  subscribe<PoseStamped>("rcm/set_cp",
                         [base](const PoseStamped& message) { return decode_rcm(message, base); });
  subscribe<surg_msgs::Fixture>("fixtures/set", [base](const surg_msgs::Fixture& message) {
    return decode_fixture(message, base);
  });
  subscribe<StringStamped>("fixtures/remove", [](const StringStamped& message) {
    return decode_fixture_name(message.string);
  });
  if (!track) return;
  subscribe<surg_msgs::PointVelocityStamped>(
      "rcm/track", [base](const surg_msgs::PointVelocityStamped& message) {
        return decode_track(message, base);
      });
}

}  // namespace surg_control
