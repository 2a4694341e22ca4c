// What housekeeping looks at: the clock (F09), the master (F07), the parameters (F16).
#include <gtest/gtest.h>

#include "surg_control/monitor/clock_watch.hpp"
#include "surg_control/monitor/master_probe.hpp"
#include "surg_control/monitor/parameter_watch.hpp"

namespace surg_control {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

TEST(ClockWatch, F09SeesAStepOnceAndNoDrift) {
  ClockWatch watch;
  std::int64_t steady = 5 * kSecond, wall = 1'700'000'000 * kSecond;
  EXPECT_EQ(watch.look(wall, steady), 0);
  for (int k = 0; k < 1000; ++k) {  // 10 % drift, far more than any slew: no single look is a step
    steady += kSecond / 4;
    wall += kSecond / 4 + kSecond / 40;
    ASSERT_EQ(watch.look(wall, steady), 0);
  }
  for (const std::int64_t step : {3600 * kSecond, -3600 * kSecond, kSecond * 6 / 10}) {
    steady += kSecond / 4;
    wall += kSecond / 4 + step;
    EXPECT_EQ(watch.look(wall, steady), step);
    EXPECT_EQ(watch.look(wall, steady), 0);
  }
  EXPECT_EQ(watch.look(wall + kSecond * 4 / 10, steady), 0);
}

TEST(ClockWatch, F09FutureIsMoreThan50Milliseconds) {
  const std::int64_t wall = 1'700'000'000 * kSecond;
  EXPECT_FALSE(is_from_the_future(0, wall));
  EXPECT_FALSE(is_from_the_future(wall - 3600 * kSecond, wall));
  EXPECT_FALSE(is_from_the_future(wall + 50'000'000, wall));
  EXPECT_TRUE(is_from_the_future(wall + 50'000'001, wall));
}

TEST(MasterWatch, F07TwoFailuresAreALoss) {
  using Change = MasterWatch::Change;
  MasterWatch watch;
  EXPECT_EQ(watch.look(42), Change::kNone);
  EXPECT_EQ(watch.look(-1), Change::kNone);
  EXPECT_EQ(watch.look(42), Change::kNone);
  EXPECT_EQ(watch.look(-1), Change::kNone);
  EXPECT_FALSE(watch.lost());
  EXPECT_EQ(watch.look(-1), Change::kLost);
  EXPECT_EQ(watch.look(-1), Change::kNone);
  EXPECT_TRUE(watch.lost());
  EXPECT_EQ(watch.look(43), Change::kNone);  // another one: it knows none of our topics
  EXPECT_TRUE(watch.lost());
  EXPECT_EQ(watch.look(42), Change::kFound);  // it had only been frozen
  EXPECT_FALSE(watch.lost());
}

TEST(ParameterWatch, F16SaysWhatChangedOnce) {
  XmlRpc::XmlRpcValue start;
  start["law"] = "ours";
  start["realtime"] = false;
  ParameterWatch watch(start);
  EXPECT_TRUE(watch.look(start).empty());
  XmlRpc::XmlRpcValue now;
  now["law"] = "paper";
  now["new"] = 3;
  const std::vector<std::string> said = watch.look(now);
  ASSERT_EQ(said.size(), 3U);
  EXPECT_EQ(said[0], "parameter ~law is 'paper' now and was 'ours' at the start");
  EXPECT_EQ(said[1], "parameter ~new is '3' now and was not set at the start");
  EXPECT_EQ(said[2], "parameter ~realtime is not set now and was '0' at the start");
  EXPECT_EQ(watch.changed(), 3U);
  EXPECT_TRUE(watch.look(now).empty());
  EXPECT_TRUE(watch.look(start).empty());
  EXPECT_EQ(watch.changed(), 0U);
  EXPECT_EQ(watch.look(now).size(), 3U);  // changed again: said again
  ParameterWatch none((XmlRpc::XmlRpcValue()));
  EXPECT_EQ(none.look(now).size(), 2U);
}

}  // namespace
}  // namespace surg_control
