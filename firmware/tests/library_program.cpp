// A program with the library from its ZIP, and with a user's message: tests/firmware/test_board_library.py
// builds it with CMake, and for an Uno, and reads what it sends.
#include <my_msgs/Gripper.h>
#include <ros.h>
#include <std_srvs/SetBool.h>

#if !defined(__AVR__)
#include <stdio.h>
#endif

namespace {

class NoHost : public ros::Link {
 public:
  void init() {}
  int read() override { return kNothing; }
  size_t write(const uint8_t*, size_t size) override { return size; }
  uint32_t milliseconds() override { return 0; }
};

void grip(const my_msgs::Gripper&) {}
void set(const std_srvs::SetBool::Request& request, std_srvs::SetBoolResponse& response) {
  response.success = request.data;
}

my_msgs::Gripper gripper;
ros::NodeHandle_<NoHost, 2, 2, 64, 128> node;
ros::Publisher publisher("gripper", &gripper);
ros::Subscriber<my_msgs::Gripper> subscriber("grip", &grip);
ros::ServiceServer<std_srvs::SetBool::Request, std_srvs::SetBool::Response> server("set", &set);

}  // namespace

int main() {
  node.initNode();
  node.advertise(publisher);
  node.subscribe(subscriber);
  node.advertiseService(server);
  float forces[] = {0.5f, -2.0f};
  const char* names[] = {"left", "right"};
  char own[] = "own";
  char* own_names[] = {own};
  gripper.header.frame_id = "hand";
  gripper.width = 0.25;
  gripper.forces = forces;
  gripper.forces_length = 2;
  gripper.names = own_names;  // as ros_lib has it
  gripper.names = names;
  gripper.names_length = 2;
  gripper.class_ = my_msgs::Gripper::HIGH_;
  publisher.publish(&gripper);
  node.spinOnce();
  uint8_t bytes[200];
  ros::Writer out(bytes, sizeof bytes);
  const bool is_written = gripper.serialize(out);
#if !defined(__AVR__)
  printf("%s %s ", static_cast<const char*>(gripper.getType()), static_cast<const char*>(gripper.getMD5()));
  for (size_t i = 0; i < out.size(); ++i) printf("%02x", bytes[i]);
#endif
  return is_written ? 0 : 1;
}
