#include "surg_control/files/black_box_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>

namespace surg_control {
namespace {

/// A file descriptor that is closed whatever happens.
class Descriptor {
 public:
  Descriptor(const std::string& path, int flags) : fd_(open(path.c_str(), flags, 0644)) {}
  ~Descriptor() {
    if (fd_ >= 0) close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return fd_; }
  bool good() const { return fd_ >= 0; }

 private:
  int fd_;
};

bool write_all(int fd, const std::string& bytes) {
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = write(fd, bytes.data() + done, bytes.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    done += static_cast<std::size_t>(n);
  }
  return fsync(fd) == 0;
}

[[noreturn]] void cannot(const std::string& what, const std::string& path) {
  const std::string why = std::strerror(errno);
  throw surg::BlackBoxError("cannot " + what + " '" + path + "': " + why);
}

}  // namespace

void write_black_box(const std::string& path, const surg::BlackBoxRecording& recording) {
  const std::string bytes = surg::encode(recording);
  const std::string part = path + ".part";
  {
    const Descriptor file(part, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC);
    if (!file.good()) cannot("write", part);
    if (!write_all(file.get(), bytes)) {
      const int error = errno;
      unlink(part.c_str());
      errno = error;
      cannot("write all of", part);
    }
  }
  if (rename(part.c_str(), path.c_str()) != 0) cannot("rename '" + part + "' to", path);
  const std::string folder = std::filesystem::path(path).parent_path().string();
  const Descriptor parent(folder.empty() ? "." : folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (parent.good()) fsync(parent.get());  // the name itself; some file systems cannot
}

surg::BlackBoxRecording read_black_box(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in) cannot("read", path);
  const std::string bytes{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  if (in.bad()) cannot("read", path);
  try {
    return surg::decode(bytes);
  } catch (const surg::BlackBoxError& error) {
    throw surg::BlackBoxError("'" + path + "': " + error.what());
  }
}

}  // namespace surg_control
