#include "surg_control/files/force_sensor.hpp"

#include <filesystem>
#include <variant>

#include "surg_core/files/document.hpp"

namespace surg_control {

bool force_is_required(const surg::ArmSetup& setup) {
  namespace fs = std::filesystem;
  const std::string name = "force_sensor_" + setup.arm.name + ".yaml";
  const fs::path file = fs::path(setup.cell_file).parent_path() / name;
  std::error_code error;
  if (!fs::exists(file, error)) return false;
  const surg::Document document = surg::load_document(file.string());
  const auto found = document.values.find("required");
  const bool* required =
      found == document.values.end() ? nullptr : std::get_if<bool>(&found->second);
  if (required == nullptr) {
    throw surg::ConfigError(file.string() +
                            ": required: is missing or no truth value; allowed: " + "true, false");
  }
  return *required;
}

}  // namespace surg_control
