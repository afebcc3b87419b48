// Publishes transforms on /tf, like ros_lib's.
#pragma once

#include <geometry_msgs/TransformStamped.h>
#include <tf/tfMessage.h>

#include "../ros/node_handle.h"

namespace tf {

class TransformBroadcaster {
 public:
  TransformBroadcaster() : publisher_("/tf", &message_) {}

  bool init(ros::NodeApi& node) { return node.advertise(publisher_); }

  int sendTransform(const geometry_msgs::TransformStamped& transform) {
    message_.transforms_length = 1;
    message_.transforms = const_cast<geometry_msgs::TransformStamped*>(&transform);  // only read
    return publisher_.publish(&message_);
  }

 private:
  tfMessage message_;
  ros::Publisher publisher_;
};

}  // namespace tf
