#include "surg_core/state/black_box.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <set>
#include <type_traits>
#include <utility>

namespace surg {
namespace {

/// Makes a call, for the first time or again; what came back.
Reason call(Controller& controller, const BlackBoxEvent& event) {
  switch (event.kind) {
    case BlackBoxEvent::Kind::kRequest:
      return controller.request(event.state);
    case BlackBoxEvent::Kind::kSetRcm:
      return controller.set_rcm(event.p_BRcm);
    case BlackBoxEvent::Kind::kFault:
      controller.fault(event.reason);
      break;
    case BlackBoxEvent::Kind::kPause:
      controller.pause(event.reason);
      break;
    case BlackBoxEvent::Kind::kClaim:
      return controller.claim(event.source);
    case BlackBoxEvent::Kind::kSetFixture:
      return controller.set_fixture(event.fixture);
    case BlackBoxEvent::Kind::kRemoveFixture:
      return controller.remove_fixture(event.fixture.title());
    case BlackBoxEvent::Kind::kCommand:
      break;
  }
  return Reason::kNone;
}

}  // namespace

// --- recording ---------------------------------------------------------------------------------

BlackBox::BlackBox(Controller& controller, const ControllerSetup& setup)
    : controller_(controller), setup_(setup), blocks_(kBlocks) {
  const std::size_t size = controller.save(nullptr, 0);
  for (Block& block : blocks_) {
    block.image.resize(size);
    block.steps.resize(kBlockSteps);
    block.events.resize(kBlockEvents);
  }
}

/// Whether the box takes notes now; the first time after a release it begins anew.
bool BlackBox::recording_now() {
  if (frozen()) {
    was_frozen_ = true;
    return false;
  }
  if (was_frozen_) {
    was_frozen_ = false;
    present_ = -1;
    used_ = 0;
    countdown_ = 0;
  }
  return true;
}

/// The block that takes what comes now; a new one begins with the image of this moment.
BlackBox::Block& BlackBox::room_for(int events) {
  const bool full = present_ < 0 || blocks_[present_].n_steps == kBlockSteps ||
                    blocks_[present_].n_events + events > kBlockEvents;
  if (full) {
    present_ = (present_ + 1) % kBlocks;
    used_ = std::min(used_ + 1, kBlocks);
    Block& block = blocks_[present_];
    block.n_steps = block.n_events = 0;
    controller_.save(block.image.data(), block.image.size());
  }
  return blocks_[present_];
}

/// Makes a call and notes it with its answer.
Reason BlackBox::make(const BlackBoxEvent& event) {
  BlackBoxEvent* noted = note(event);
  const Reason answer = call(controller_, event);
  if (noted) noted->answer = answer;
  return answer;
}

Reason BlackBox::request(StateCommand command) {
  BlackBoxEvent event{BlackBoxEvent::Kind::kRequest};
  event.state = command;
  return make(event);
}

Reason BlackBox::set_rcm(const Vector3& p_BRcm) {
  BlackBoxEvent event{BlackBoxEvent::Kind::kSetRcm};
  event.p_BRcm = p_BRcm;
  return make(event);
}

Reason BlackBox::set_fixture(const Fixture& fixture) {
  BlackBoxEvent event{BlackBoxEvent::Kind::kSetFixture};
  event.fixture = fixture;
  return make(event);
}

Reason BlackBox::remove_fixture(std::string_view name) {
  BlackBoxEvent* event = note({BlackBoxEvent::Kind::kRemoveFixture});
  const Reason answer = controller_.remove_fixture(name);
  if (event) {
    event->fixture.set_name(name);
    event->answer = answer;
  }
  return answer;
}

Reason BlackBox::change_tool(const InstrumentConfig& instrument, const ToolCalibration& tool) {
  if (frozen() || countdown_ > 0) return Reason::kNotAtRest;
  const Reason answer = controller_.change_tool(instrument, tool);
  if (answer != Reason::kNone) return answer;
  instrument_ = &instrument;
  tool_ = &tool;
  present_ = -1;
  used_ = 0;
  return Reason::kNone;
}

void BlackBox::fault(Reason reason) {
  BlackBoxEvent event{BlackBoxEvent::Kind::kFault};
  event.reason = reason;
  make(event);
}

void BlackBox::pause(Reason reason) {
  BlackBoxEvent event{BlackBoxEvent::Kind::kPause};
  event.reason = reason;
  make(event);
}

Reason BlackBox::claim(std::uint32_t source) {
  BlackBoxEvent event{BlackBoxEvent::Kind::kClaim};
  event.source = source;
  return make(event);
}

/// Notes a call that is about to be made; its answer is still to come. None while frozen.
BlackBoxEvent* BlackBox::note(const BlackBoxEvent& event) {
  if (!recording_now()) return nullptr;
  Block& block = room_for(1);
  BlackBoxEvent& noted = block.events[block.n_events++];
  noted = event;
  return &noted;
}

const Outputs& BlackBox::step(const Inputs& inputs) {
  const int n = std::clamp(inputs.n_commands, 0, kMaxCommands);
  Block* block = recording_now() ? &room_for(n) : nullptr;
  const Outputs& out = controller_.step(inputs);
  if (block) {
    for (int i = 0; i < n; ++i) {
      BlackBoxEvent& event = block->events[block->n_events++];
      event.kind = BlackBoxEvent::Kind::kCommand;
      event.command = inputs.commands[i];
    }
    BlackBoxStep& step = block->steps[block->n_steps++];
    step.in = inputs;
    step.n_commands = n;
    step.events = block->n_events;  // so far in the block: recording() makes it a count
    step.out = out;
  }
  watch(out.state, block != nullptr);
  return out;
}

void BlackBox::trigger() {
  if (recording_now() && countdown_ == 0) countdown_ = kAfter;
}

void BlackBox::watch(State now, bool recorded) {
  const bool fault = now == State::kFault && last_ != State::kFault;
  last_ = now;
  if (!recorded) return;
  if (countdown_ > 0 && --countdown_ == 0) frozen_.store(true, std::memory_order_release);
  if (fault) trigger();
}

BlackBoxRecording BlackBox::recording(const BlackBoxLabel& label) const {
  BlackBoxRecording recording;
  recording.label = label;
  recording.setup = setup_;
  if (instrument_) recording.setup.instrument = *instrument_;
  if (tool_) recording.setup.tool = *tool_;
  ControllerSetup& setup = recording.setup;
  if (instrument_ && setup.clearance.active()) {
    mount(setup.clearance.own, setup.robot, setup.instrument, setup.tool);
  }
  int trailing = 0;  // calls behind the last step of the block before
  for (int i = 0; i < used_; ++i) {
    const Block& block = blocks_[(present_ + 1 + kBlocks - used_ + i) % kBlocks];
    if (i == 0) recording.image = block.image;
    int last = 0;
    for (int k = 0; k < block.n_steps; ++k) {
      recording.steps.push_back(block.steps[k]);
      recording.steps.back().events = block.steps[k].events - last + trailing;
      last = block.steps[k].events;
      trailing = 0;
    }
    trailing += block.n_events - last;
    recording.events.insert(recording.events.end(), block.events.begin(),
                            block.events.begin() + block.n_events);
  }
  return recording;
}

// --- file --------------------------------------------------------------------------------------

namespace {

constexpr char kMagic[] = "SURGBBX";  // eight bytes with its end
constexpr std::uint32_t kVersion = 7;
constexpr std::size_t kHead = sizeof kMagic + sizeof kVersion + sizeof(std::uint64_t);

static_assert(sizeof kMagic == 8 && sizeof(double) == 8);

std::uint64_t checksum(std::string_view bytes) {
  std::uint64_t hash = 1469598103934665603ULL;  // FNV-1a, 64 bit: sees every single changed byte
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211ULL;
  return hash;
}

/// Both directions of the file: numbers as they lie in memory (little-endian), lengths before
/// strings, lists and joint vectors. Reading never trusts a length.
class Coder {
 public:
  Coder() = default;  // writes
  explicit Coder(std::string_view from) : reading_(true), from_(from) {}

  template <typename... T>
  void operator()(T&... values) {
    (value(values), ...);
  }

  const std::string& written() const { return written_; }
  bool at_end() const { return from_.empty(); }

  [[noreturn]] static void broken(const std::string& what) {
    throw BlackBoxError("its contents make no sense: " + what +
                        "; it was written by another version: read it with that one");
  }

 private:
  void bytes(void* data, std::size_t size) {
    if (!reading_) {
      written_.append(static_cast<const char*>(data), size);
      return;
    }
    if (size > from_.size()) broken("it ends in the middle of a value");
    std::memcpy(data, from_.data(), size);
    from_.remove_prefix(size);
  }

  /// A length; 'least' bytes must follow for each.
  std::size_t length(std::size_t n, std::size_t least) {
    auto stored = static_cast<std::uint32_t>(n);
    bytes(&stored, sizeof stored);
    if (reading_ && stored > from_.size() / least) broken("a length is too large");
    return stored;
  }

  template <typename T>
  std::enable_if_t<std::is_arithmetic_v<T>> value(T& number) {
    bytes(&number, sizeof number);
  }
  void value(bool& flag) {
    auto byte = static_cast<std::uint8_t>(flag);
    bytes(&byte, 1);
    if (byte > 1) broken("a flag is neither 0 nor 1");
    flag = byte == 1;
  }
  template <typename T>
  std::enable_if_t<std::is_enum_v<T>> value(T& word) {
    auto number = static_cast<std::int32_t>(word);
    bytes(&number, sizeof number);
    if (number < 0 || number > 255) broken("a name has number " + std::to_string(number));
    word = static_cast<T>(number);
  }
  void value(std::string& text) {
    text.resize(length(text.size(), 1));
    bytes(text.data(), text.size());
  }
  /// A static string: when read back, one that lives as long as the program.
  void value(const char*& text) {
    std::string copy = text ? text : "";
    value(copy);
    if (!reading_) return;
    static std::set<std::string> known;
    text = known.insert(copy).first->c_str();
  }
  template <typename T>
  void value(std::vector<T>& list) {
    list.resize(length(list.size(), 1));
    for (T& item : list) value(item);
  }
  void value(std::byte& byte) { bytes(&byte, 1); }
  template <typename S, int R, int C, int O, int MR, int MC>
  void value(Eigen::Matrix<S, R, C, O, MR, MC>& matrix) {
    if constexpr (R == Eigen::Dynamic) {
      const std::size_t rows = length(static_cast<std::size_t>(matrix.rows()), sizeof(S));
      if (rows > static_cast<std::size_t>(MR)) broken("too many joints");
      matrix.resize(static_cast<Eigen::Index>(rows));
    }
    bytes(matrix.data(), sizeof(S) * static_cast<std::size_t>(matrix.size()));
  }
  void value(Pose& X) { value(X.matrix()); }
  void value(Eigen::Quaterniond& q) { value(q.coeffs()); }

  /// A struct of numbers only, whichever they are.
  template <typename T>
  void numbers(T& values) {
    static_assert(std::is_trivially_copyable_v<T>);
    std::uint32_t size = sizeof values;
    bytes(&size, sizeof size);
    if (size != sizeof values) broken("limits, tuning or options have other members");
    bytes(&values, sizeof values);
  }
  void value(Limits& limits) { numbers(limits); }
  void value(Tuning& tuning) { numbers(tuning); }
  void value(Controller::Options& options) { numbers(options); }

  void value(Joint& joint) { (*this)(joint.name, joint.X_PJ, joint.axis, joint.continuous); }
  void value(Chain& chain) {
    std::vector<Joint> joints = chain.joints();
    Pose X_LF = chain.X_LF();
    (*this)(joints, X_LF);
    if (reading_) chain = Chain(joints, X_LF);
  }
  void value(RobotConfig& c) {
    (*this)(c.file, c.name, c.urdf, c.base_link, c.flange_link, c.command, c.joint_names, c.home,
            c.position_min, c.position_max, c.velocity, c.acceleration, c.limits, c.tuning,
            c.joint_lag, c.elbow);
  }
  void value(InstrumentConfig& c) {
    (*this)(c.file, c.name, c.urdf, c.mount_link, c.tip_link, c.jaw_min, c.jaw_max, c.jaw_velocity,
            c.passive);
    bool wristed = c.wrist.has_value();
    value(wristed);
    if (!wristed) return;
    if (!c.wrist) c.wrist.emplace();
    WristConfig& w = *c.wrist;
    (*this)(w.geometry.pitch_to_yaw, w.geometry.yaw_to_tip, w.pitch_axis_F, w.min, w.max,
            w.velocity, w.acceleration, w.drive_lag);
  }
  void value(ToolCalibration& c) { (*this)(c.s_F, c.p_FTip, c.residual, c.condition, c.n, c.date); }
  void value(Capsule& c) { (*this)(c.a, c.b, c.radius); }
  void value(LinkCapsule& c) { (*this)(c.name, c.joint, c.shape, c.shaft); }
  void value(ArmShape& c) { (*this)(c.name, c.chain, c.X_WB, c.capsules); }
  void value(Obstacle& c) {
    (*this)(c.name, c.half_space, c.capsule, c.space.point, c.space.normal);
  }
  void value(ClearanceSetup& c) {
    bool guarded = c.active();
    value(guarded);
    if (!guarded) return;
    (*this)(c.distance, c.shafts, c.own, c.others, c.obstacles);
    if (c.others.size() > kMaxOtherArms) broken("too many arms");
  }
  void value(OtherArm& c) { (*this)(c.valid, c.age, c.q, c.qd); }
  void value(ControllerSetup& c) {
    (*this)(c.chain, c.robot, c.limits, c.instrument, c.tool, c.options, c.clearance);
  }
  void value(BlackBoxLabel& c) { (*this)(c.arm, c.cell, c.written, c.version); }
  void value(MotionCommand& c) {
    (*this)(c.motion, c.source, c.p, c.rotation, c.roll_rate, c.omega, c.joints, c.wrist, c.jaw,
            c.elbow, c.stamp_ns, c.age, c.slide);
  }
  void value(Fixture& f) {
    bytes(f.name.data(), f.name.size());
    if (f.name.back() != 0) broken("a fixture's name has no end");
    (*this)(f.shape, f.side, f.of, f.of_cell, f.point, f.axis, f.radius);
  }
  void value(BlackBoxEvent& e) {
    (*this)(e.kind, e.state, e.reason, e.answer, e.source, e.p_BRcm, e.command);
    if (e.kind > BlackBoxEvent::Kind::kRemoveFixture) broken("a call is of no known kind");
    const bool fixture =
        e.kind == BlackBoxEvent::Kind::kSetFixture || e.kind == BlackBoxEvent::Kind::kRemoveFixture;
    if (fixture) (*this)(e.fixture);
  }
  void value(Outputs& out);
  void value(ForceSample& f) { (*this)(f.valid, f.f_B); }
  void value(Readings& r) {
    (*this)(r.elapsed, r.state_valid, r.state_age, r.q, r.qd, r.condition, r.condition_age, r.jaw,
            r.jaw_age, r.wrist, r.wrist_rate, r.tip_force, r.trocar_force, r.track_valid,
            r.track_age, r.p_BTrack, r.v_BTrack);
    for (OtherArm& other : r.others) value(other);
  }
  void value(BlackBoxStep& s) { (*this)(s.in, s.events, s.n_commands, s.out); }

  bool reading_ = false;
  std::string written_;
  std::string_view from_;
};

/// Every field of Outputs but the verdicts, with its name.
template <typename Visit>
void each_field(Outputs& out, Visit visit) {
  visit("state", out.state);
  visit("reason", out.reason);
  visit("homed", out.homed);
  visit("busy", out.busy);
  visit("motion", out.motion);
  visit("source", out.source);
  visit("accepted", out.accepted);
  visit("refused", out.refused);
  visit("warn_rcm", out.warn_rcm);
  visit("warn_force", out.warn_force);
  visit("link_lag", out.link_lag);
  visit("joint_lag", out.joint_lag);
  visit("warn_track", out.warn_track);
  visit("X_BF", out.X_BF);
  visit("p_BTip", out.p_BTip);
  visit("s_B", out.s_B);
  visit("p_BRcm", out.p_BRcm);
  visit("v_BTip", out.v_BTip);
  visit("roll", out.roll);
  visit("depth", out.depth);
  visit("rcm_error", out.rcm_error);
  visit("virtual_q", out.virtual_q);
  visit("virtual_qd", out.virtual_qd);
  visit("virtual_set", out.virtual_set);
  visit("p_goal", out.p_goal);
  visit("p_set", out.p_set);
  visit("v_set", out.v_set);
  visit("roll_goal", out.roll_goal);
  visit("roll_set", out.roll_set);
  visit("jaw_set", out.jaw_set);
  visit("jaw", out.jaw);
  visit("wrist", out.wrist.exists);
  visit("wrist_turn", out.wrist.geometry.turn);
  visit("wrist_q", out.wrist.q);
  visit("wrist_qd", out.wrist.qd);
  visit("wrist_set", out.wrist.set);
  visit("wrist_goal", out.wrist.goal);
  visit("wrist_command", out.wrist.command);
  visit("R_RTip", out.wrist.R_RTip);
  visit("R_RSet", out.wrist.R_RSet);
  visit("R_RGoal", out.wrist.R_RGoal);
  visit("omega_B", out.wrist.omega_B);
  visit("elbow_goal", out.elbow_goal);
  visit("elbow_limit", out.elbow_limit);
  visit("scale", out.scale);
  visit("limited_by", out.limited_by);
  visit("tier", out.tier);
  visit("late_share", out.late_share);
  visit("clearance", out.clearance);
  visit("stop_bound.tip", out.stop_bound.tip);
  visit("stop_bound.pivot", out.stop_bound.pivot);
  visit("qd_command", out.qd_command);
  visit("twist_command", out.twist_command);
}

void Coder::value(Outputs& out) {
  each_field(out, [this](const char*, auto& field) { value(field); });
  value(out.n_verdicts);
  if (out.n_verdicts < 0 || out.n_verdicts > kMaxCommands) broken("too many verdicts");
  for (int i = 0; i < out.n_verdicts; ++i) {
    Verdict& verdict = out.verdicts[i];
    (*this)(verdict.reason, verdict.source, verdict.motion);
  }
}

}  // namespace

std::string encode(BlackBoxRecording recording) {
  Coder coder;
  coder(recording.label, recording.setup, recording.image, recording.steps, recording.events);
  const std::string& contents = coder.written();
  const std::uint64_t length = contents.size(), sum = checksum(contents);
  std::string file(kMagic, sizeof kMagic);
  file.append(reinterpret_cast<const char*>(&kVersion), sizeof kVersion);
  file.append(reinterpret_cast<const char*>(&length), sizeof length);
  file += contents;
  file.append(reinterpret_cast<const char*>(&sum), sizeof sum);
  return file;
}

BlackBoxRecording decode(std::string_view bytes) {
  if (bytes.substr(0, sizeof kMagic) != std::string_view(kMagic, sizeof kMagic)) {
    throw BlackBoxError("it is not a black box: it does not begin with SURGBBX");
  }
  std::uint32_t version = 0;
  std::uint64_t length = 0, sum = 0;
  if (bytes.size() < kHead + sizeof sum) {
    throw BlackBoxError("it is cut short: only " + std::to_string(bytes.size()) + " bytes");
  }
  std::memcpy(&version, bytes.data() + sizeof kMagic, sizeof version);
  if (version != kVersion) {
    throw BlackBoxError("it has format version " + std::to_string(version) +
                        "; this program reads version " + std::to_string(kVersion));
  }
  std::memcpy(&length, bytes.data() + sizeof kMagic + sizeof version, sizeof length);
  if (length != bytes.size() - kHead - sizeof sum) {
    throw BlackBoxError("its length is wrong: " + std::to_string(bytes.size()) + " bytes, but " +
                        std::to_string(length) + " of contents are announced; copy it again");
  }
  const std::string_view contents = bytes.substr(kHead, length);
  std::memcpy(&sum, bytes.data() + kHead + length, sizeof sum);
  if (sum != checksum(contents)) {
    throw BlackBoxError("its checksum is wrong: the file is damaged; copy it again");
  }
  BlackBoxRecording recording;
  Coder coder(contents);
  try {
    coder(recording.label, recording.setup, recording.image, recording.steps, recording.events);
  } catch (const std::invalid_argument& error) {  // of Chain
    Coder::broken(error.what());
  }
  if (!coder.at_end()) Coder::broken("something is left over at its end");
  std::size_t events = 0;
  for (const BlackBoxStep& step : recording.steps) {
    events += step.events;
    if (step.n_commands > std::min<std::uint32_t>(step.events, kMaxCommands)) {
      Coder::broken("a step has more commands than events");
    }
  }
  if (events > recording.events.size()) Coder::broken("events are missing");
  return recording;
}

// --- replay ------------------------------------------------------------------------------------

namespace {

std::string shown(double x) {
  char text[48];
  if (std::isnan(x)) {  // has many bit patterns
    std::uint64_t bits = 0;
    std::memcpy(&bits, &x, sizeof bits);
    std::snprintf(text, sizeof text, "nan (%016llx)", static_cast<unsigned long long>(bits));
  } else {
    std::snprintf(text, sizeof text, "%.17g", x);
  }
  return text;
}
std::string shown(const char* text) { return std::string("'") + text + "'"; }
std::string shown(State state) { return name(state); }
std::string shown(Reason reason) { return name(reason); }
std::string shown(TrackWarning warning) { return name(warning); }
std::string shown(Motion motion) { return "motion " + std::to_string(static_cast<int>(motion)); }
template <typename Derived>
std::string shown(const Eigen::MatrixBase<Derived>& matrix) {
  std::string text;
  for (Eigen::Index i = 0; i < matrix.size(); ++i) {
    text +=
        (i ? ", " : "") + shown(static_cast<double>(matrix(i % matrix.rows(), i / matrix.rows())));
  }
  return "(" + text + ")";
}
std::string shown(const Pose& X) { return shown(X.matrix()); }

/// Bytes as in the file, to compare, and words to show.
struct Field {
  std::string name, bytes, text;
};

std::vector<Field> fields_of(Outputs& out) {
  std::vector<Field> fields;
  each_field(out, [&fields](const char* name, auto& field) {
    Coder coder;
    coder(field);
    fields.push_back({name, coder.written(), shown(field)});
  });
  for (int i = 0; i < out.n_verdicts; ++i) {
    const std::string verdict = shown(out.verdicts[i].reason);
    fields.push_back({"verdict " + std::to_string(i), verdict, verdict});
  }
  return fields;
}

std::string bytes_of(Outputs& out) {
  Coder coder;
  coder(out);
  return coder.written();
}

/// The first field that differs; one there is.
BlackBoxDifference first_difference(std::size_t step, Outputs& recorded, Outputs& replayed) {
  const std::vector<Field> was = fields_of(recorded), is = fields_of(replayed);
  for (std::size_t i = 0; i < std::min(was.size(), is.size()); ++i) {
    if (was[i].bytes != is[i].bytes) return {step, was[i].name, was[i].text, is[i].text};
  }
  return {step, "n_verdicts", std::to_string(recorded.n_verdicts),
          std::to_string(replayed.n_verdicts)};
}

/// Of each BlackBoxEvent::Kind, in order.
constexpr const char* kKinds[] = {"request", "set_rcm", "fault",       "pause",
                                  "claim",   "command", "set_fixture", "remove_fixture"};

}  // namespace

std::optional<BlackBoxDifference> replay(const BlackBoxRecording& recording) {
  const ControllerSetup& setup = recording.setup;
  Controller controller(setup.chain, setup.robot, setup.limits, setup.instrument, setup.tool,
                        setup.options, setup.clearance);
  if (!controller.restore(recording.image.data(), recording.image.size())) {
    throw BlackBoxError("its controller's memory (" + std::to_string(recording.image.size()) +
                        " bytes) is laid out otherwise than this program's (" +
                        std::to_string(controller.save(nullptr, 0)) +
                        "): replay it with the version that wrote it: " +
                        (recording.label.version.empty() ? "unknown" : recording.label.version));
  }
  Inputs in;
  auto event = recording.events.begin();
  const auto call_next = [&](std::size_t step) -> std::optional<BlackBoxDifference> {
    const Reason answer = call(controller, *event);
    const BlackBoxEvent& was = *event++;
    if (answer == was.answer) return std::nullopt;
    return BlackBoxDifference{step, kKinds[static_cast<int>(was.kind)], shown(was.answer),
                              shown(answer)};
  };
  for (std::size_t k = 0; k < recording.steps.size(); ++k) {
    const BlackBoxStep& step = recording.steps[k];
    for (std::uint32_t i = step.n_commands; i < step.events; ++i) {
      if (auto difference = call_next(k)) return difference;
    }
    static_cast<Readings&>(in) = step.in;
    in.n_commands = static_cast<int>(step.n_commands);
    for (int i = 0; i < in.n_commands; ++i) in.commands[i] = (event++)->command;
    Outputs replayed = controller.step(in), recorded = step.out;
    if (bytes_of(replayed) != bytes_of(recorded)) return first_difference(k, recorded, replayed);
  }
  while (event != recording.events.end()) {
    if (auto difference = call_next(recording.steps.size())) return difference;
  }
  return std::nullopt;
}

}  // namespace surg
