// Debian's camera_info_manager on one lens file: prints what a camera driver of ROS would publish.
#include <camera_info_manager/camera_info_manager.h>
#include <ros/ros.h>

#include <cstdio>

int main(int argc, char** argv) {
  ros::init(argc, argv, "lens_file", ros::init_options::AnonymousName);
  if (argc != 3) {
    return 2;
  }
  ros::NodeHandle node("~");
  camera_info_manager::CameraInfoManager manager(node, argv[1], argv[2]);
  const bool calibrated = manager.isCalibrated();
  const sensor_msgs::CameraInfo info = manager.getCameraInfo();
  std::printf("%d %u %u %s\n", calibrated ? 1 : 0, info.width, info.height,
              info.distortion_model.c_str());
  const auto print = [](const auto& values) {
    for (const double value : values) {
      std::printf("%.17g ", value);
    }
    std::printf("\n");
  };
  print(info.D);
  print(info.K);
  print(info.R);
  print(info.P);
  return 0;
}
